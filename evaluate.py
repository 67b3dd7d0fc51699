"""`neurosym evaluate` in a clone: `python evaluate.py --help`."""

import sys

from neurosym_jax.__main__ import main

if __name__ == "__main__":
    main(["evaluate", *sys.argv[1:]])
