"""A file that grows is in its place whole or not at all, whatever fails on the disk."""

from neurosym_robot.online.growing_file import GrowingFile
from tests.test_faults import every_fault


def test_a_file_that_grows_is_there_whole_or_not_at_all(tmp_path):
    path = tmp_path / "run" / "forecasts.jsonl"

    def work():
        file = GrowingFile(path)
        try:
            for number in range(3):
                file.write(f"{number}\n")
        finally:
            file.close("end\n")

    def check(done):
        if done or path.exists():
            assert path.read_text() == "0\n1\n2\nend\n"
            path.unlink()
        assert not path.parent.exists() or not list(path.parent.iterdir())

    every_fault(work, check)
