"""What a caller asks for, from a design to a plan that is proven or carried out by an arm."""
