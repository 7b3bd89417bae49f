import pytest


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--repetitions", 0, "--out", "study"], "halfseen: repetitions is 0; "),
        (["--only", "rewards"], "--only rewards: there is no such experiment; there are reward, planning"),
        (["--out", "file/study"], "cannot be written"),
        (["--out", "study", "no_such_table.pcd"], "no_such_table.pcd"),
        (["--out", "study", "--law", "no_such_law"], "no_such_law"),
    ],
)
def test_bad_input_is_refused_and_nothing_is_written(refused, tmp_path, monkeypatch, words, told):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert told in refused("study", *words)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
