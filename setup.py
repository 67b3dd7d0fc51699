"""What pyproject.toml cannot say: the wheel holds `checkpoints/` inside neurosym_jax."""

from setuptools import find_packages, setup

setup(
    packages=[
        *find_packages(include=["neurosym_jax*", "neurosym_robot*"]),
        "neurosym_jax.checkpoints",
    ],
    package_dir={"neurosym_jax.checkpoints": "checkpoints"},
)
