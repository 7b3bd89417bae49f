"""The attempts of cut episodes are those that their log holds."""

import numpy as np
import pandas as pd
import pytest
from tiny import SETTING

from halfseen.study.pipeline import Source
from halfseen.study.tried import tried_in
from halfseen.tables import attempts
from halfseen.world.logs import to_logs


@pytest.mark.parametrize("kind", ["independent", "attempt"])
def test_they_are_what_is_read_from_the_log(kind):
    source = Source(SETTING.world, SETTING.layouts, 0, 3)
    cuts = source.cut(source.play(40), source.cut_rate(0.5, kind), kind)
    tried = tried_in(cuts)
    read = attempts(to_logs(cuts, kind, SETTING.scenes), SETTING.world.horizon)
    assert len(tried) > 40
    assert 0 < (~tried["is_finished"]).sum() < len(tried)
    pd.testing.assert_frame_equal(tried.drop(columns="object"), read.drop(columns="object"), check_dtype=False)
    same = (np.equal.outer(each["object"].to_numpy(), each["object"].to_numpy()) for each in (tried, read))
    np.testing.assert_array_equal(*same)
