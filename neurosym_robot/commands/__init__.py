"""Commands, a file each: options and a call."""
