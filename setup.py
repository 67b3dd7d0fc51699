"""What pyproject.toml cannot say: `checkpoints/` inside neurosym_jax, an index's description, and
a source distribution with the same bytes whenever and wherever it is built.
"""

import gzip
import os
import re
import shutil
import tarfile
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

# 1980, the first year that a wheel can have.
EPOCH = int(os.environ.get("SOURCE_DATE_EPOCH", 315_532_800))


class SourceDistribution(sdist):
    """A `.tar.gz` in which order, times, owners and modes are not those of this machine."""

    def make_archive(self, base_name, format, root_dir=None, base_dir=None, **owners):
        """Write the archive of the folder `base_dir`; return its path."""
        if format != "gztar":
            return super().make_archive(base_name, format, root_dir, base_dir, **owners)
        path = f"{base_name}.tar.gz"
        with (
            open(path, "wb") as file,
            gzip.GzipFile("", "wb", 9, file, EPOCH) as packed,
            tarfile.open(
                fileobj=packed, mode="w", format=tarfile.PAX_FORMAT
            ) as archive,
        ):
            for entry in [Path(base_dir), *sorted(Path(base_dir).rglob("*"))]:
                archive.add(entry, recursive=False, filter=_of_nobody)
        return path


def _of_nobody(entry):
    """The entry of an archive, with the epoch's time and nobody's name."""
    is_run = entry.isdir() or entry.mode & 0o100
    entry.mode = 0o755 if is_run else 0o644
    entry.mtime, entry.uid, entry.gid, entry.uname, entry.gname = EPOCH, 0, 0, "", ""
    return entry


# On an index there are no files beside the description: pictures and links to them
# become text.
README = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
DESCRIPTION = re.sub(r"!?\[([^]]+)\]\((?!https:)[^)]*\)", r"\1", README)


class BuildWithCheckpoints(build_py):
    """Puts `checkpoints/` into the package of a wheel; an editable install reads the clone's."""

    def run(self):
        """Build, then copy."""
        super().run()
        if not self.editable_mode:
            target = Path(self.build_lib, "neurosym_jax", "checkpoints")
            shutil.copytree("checkpoints", target, dirs_exist_ok=True)


setup(
    long_description=DESCRIPTION,
    long_description_content_type="text/markdown",
    packages=find_packages(include=["neurosym_jax*", "neurosym_robot*"]),
    # An editable install is then a line of sys.path, and no import hook: editors and
    # pyright follow lines only.
    package_dir={"": "."},
    cmdclass={"build_py": BuildWithCheckpoints, "sdist": SourceDistribution},
)
