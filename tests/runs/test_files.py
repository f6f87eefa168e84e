"""Files of a run that are copied."""

from __future__ import annotations

import pandas as pd
import pytest

from torchrl_atr.runs.files import LOG, copy_log


@pytest.mark.parametrize(("most", "kept"), [(1, [0]), (2, [0, 3]), (3, [0, 2, 4]), (5, [0, 1, 2, 3, 4])])
def test_a_copied_log_has_at_most_as_many_rows_as_asked_for_evenly_spaced(tmp_path, most, kept):
    copy = tmp_path / "copy"
    copy.mkdir()
    pd.DataFrame({"frames": range(5)}).to_csv(tmp_path / LOG, index=False)
    copy_log(tmp_path, copy, most)
    assert pd.read_csv(copy / LOG)["frames"].tolist() == kept
