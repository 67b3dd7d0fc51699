"""What pyproject.toml cannot say: `checkpoints/` inside neurosym_jax, an index's description."""

import re
from pathlib import Path

from setuptools import find_packages, setup

# On an index there are no files beside the description: pictures and links to them
# become text.
README = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
DESCRIPTION = re.sub(r"!?\[([^]]+)\]\((?!https:)[^)]*\)", r"\1", README)

setup(
    long_description=DESCRIPTION,
    long_description_content_type="text/markdown",
    packages=[
        *find_packages(include=["neurosym_jax*", "neurosym_robot*"]),
        "neurosym_jax.checkpoints",
    ],
    package_dir={"neurosym_jax.checkpoints": "checkpoints"},
)
