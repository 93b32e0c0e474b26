"""What our learners are compared with is what torch computes."""

import importlib.util
import json
import pathlib

import pytest

LEARNERS = pathlib.Path(__file__).parent.parent / "learners"


def reference():
    spec = importlib.util.spec_from_file_location("torch_reference", LEARNERS / "torch_reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_kept_reference_is_what_torch_computes():
    import torch

    kept = json.loads((LEARNERS / "torch_reference.json").read_text())
    usual = torch.get_default_dtype()
    try:
        cases = reference().CASES
        assert cases.keys() == kept.keys()
        for name, case in cases.items():
            found = case()
            assert found.keys() == kept[name].keys()
            for part, values in found.items():
                assert values == pytest.approx(kept[name][part], abs=1e-7), f"{name}: {part}"
    finally:
        torch.set_default_dtype(usual)
