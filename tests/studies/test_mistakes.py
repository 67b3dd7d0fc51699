import re

import pytest

from studies.mistakes.__main__ import tell
from studies.mistakes.corpus import MISTAKES


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.name)
def test_mistakes(mistake, tmp_path):
    found, said = tell(mistake, tmp_path)
    assert (found, bool(re.search(mistake.says, said))) == (mistake.wanted, True), said
