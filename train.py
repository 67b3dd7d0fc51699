"""`neurosym train` in a clone: `python train.py --help`."""

import sys

from neurosym_jax.__main__ import main

if __name__ == "__main__":
    main(["train", *sys.argv[1:]])
