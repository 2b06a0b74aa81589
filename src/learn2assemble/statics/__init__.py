"""Does it stand: forces in joints, programs, certificates and margins of blocks at any pose."""
