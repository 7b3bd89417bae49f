import onnxruntime
import pytest

from halfseen.learning import CensoredQLearner
from halfseen.policies.folder import write_policy
from small_logs import flat_log, table_log


def test_a_policy_is_exported_once_and_replaced_only_when_told(typed, refused, tmp_path):
    logs, out = flat_log(), tmp_path / "policy.onnx"
    write_policy(CensoredQLearner(2, ["A", "B", "C"], ["x1", "x2"], reg=0.1).fit(logs), logs, tmp_path / "policy")
    done = typed("export", tmp_path / "policy", "--onnx", out)
    assert (done.status, done.out.split()[0]) == (0, f"{out}:")
    assert [each.name for each in onnxruntime.InferenceSession(out).get_inputs()] == ["covariates", "stage"]
    assert "--overwrite" in refused("export", tmp_path / "policy", "--onnx", out)
    assert typed("export", tmp_path / "policy", "--onnx", out, "--overwrite").status == 0
    assert "ends in .onnx" in refused("export", tmp_path / "policy", "--onnx", tmp_path / "policy.bin")


@pytest.mark.slow
def test_a_policy_of_tables_is_exported_for_a_number_of_objects(typed, tmp_path):
    logs, out = table_log(), tmp_path / "policy.onnx"
    write_policy(CensoredQLearner.for_table(3, reg=0.1).fit(logs), logs, tmp_path / "policy")
    assert typed("export", tmp_path / "policy", "--onnx", out, "--objects", 4).status == 0
    shapes = {each.name: each.shape for each in onnxruntime.InferenceSession(out).get_inputs()}
    assert (shapes["hides"], shapes["log_odds"], shapes["steps_to_go"]) == ([4, 4], [4], [])
