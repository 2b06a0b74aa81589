"""A policy in another process: nothing but the standard library, in any language alike.

    python examples/benchmark/server.py 5005 &
    l2a benchmark run other.jsonl.gz --server 127.0.0.1:5005 --name "first that stands"

One line of JSON comes for every decision, and one goes back. It takes the first action that
would stand, where that is said, and ends when the benchmark does.
"""

import json
import socketserver
import sys


class Answer(socketserver.StreamRequestHandler):
    """One run of the benchmark."""

    def handle(self) -> None:
        """Answer until nobody asks any more."""
        for line in self.rfile:
            info = json.loads(line)["info"]
            allowed = info.get("physics_mask") or info["action_masks"]
            self.wfile.write(json.dumps({"action": allowed[0]}).encode() + b"\n")


with socketserver.TCPServer(("127.0.0.1", int(sys.argv[1])), Answer) as server:
    print(f"listening on port {server.server_address[1]}", flush=True)
    server.handle_request()
