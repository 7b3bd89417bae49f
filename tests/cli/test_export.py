import onnxruntime
import pytest


def test_a_policy_is_exported_once_and_replaced_only_when_told(typed, refused, house, tmp_path):
    out = tmp_path / "policy.onnx"
    done = typed("export", house / "policy", "--onnx", out)
    assert (done.status, done.out.split()[0]) == (0, f"{out}:")
    assert [each.name for each in onnxruntime.InferenceSession(out).get_inputs()] == ["covariates", "stage"]
    assert "--overwrite" in refused("export", house / "policy", "--onnx", out)
    assert typed("export", house / "policy", "--onnx", out, "--overwrite").status == 0


@pytest.mark.slow
def test_a_policy_of_tables_is_exported_for_a_number_of_objects(typed, house, tmp_path):
    out = tmp_path / "policy.onnx"
    assert typed("export", house / "table-policy", "--onnx", out, "--objects", 4).status == 0
    shapes = {each.name: each.shape for each in onnxruntime.InferenceSession(out).get_inputs()}
    assert (shapes["hides"], shapes["log_odds"], shapes["steps_to_go"]) == ([4, 4], [4], [])
