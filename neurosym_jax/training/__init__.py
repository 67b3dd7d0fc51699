"""Training of generators and discriminators: losses, one pure step, and the loop around it."""
