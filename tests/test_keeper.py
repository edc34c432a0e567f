"""What the daemon keeps on disk, asked by the fleet."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge_daemon.keeper import Keeper
from edge_daemon.settings import Store


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"limit": "nan"}, "limit: 'nan' is not a number"),
        ({"limit": "0"}, "limit: '0': expected at least 1"),
        ({"limit": "-5"}, "limit: '-5': expected at least 1"),
        ({"since_s": "yesterday"}, "since_s: 'yesterday' is not a number"),
        ({"names": "stifness"}, "names: 'stifness' is not estimated"),
    ],
)
def test_a_question_that_makes_no_sense_says_why(tmp_path: Path, parameters: dict[str, str], complaint: str) -> None:
    keeper = Keeper(Store(file="s.sqlite"), tmp_path)
    with pytest.raises(ValueError, match=complaint):
        keeper.history("axis-1", parameters)
    assert keeper.history("axis-1", {"limit": "inf"}) == []
    keeper.close()
