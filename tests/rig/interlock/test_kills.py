"""Kill -9 in the middle of a sweep: two moments of the campaign that `make kills` runs fifty of."""

import pytest

from tests.kills import kill_once


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("after_s", [0.4, 5.3])
def test_a_killed_sweep_loses_no_row_and_leaves_the_regulator_at_zero(after_s):
    kill = kill_once(after_s)
    assert kill.fault == ""
    assert not kill.finished
    assert kill.rows_after > 0
    assert kill.raised == (after_s > 5.0)  # so that there was something to take back
