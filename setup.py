"""What pyproject.toml cannot say: a wheel holds the models of `checkpoints/` within the package."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["neurosym_jax*"]), "neurosym_jax.checkpoints"],
    package_dir={"neurosym_jax.checkpoints": "checkpoints"},
)
