"""Programs at random with arrays that loops keep in memory: by LLVM's good code, as users have it, beside XLA."""

import pytest
from table_generator import Case, judged

from jaxik.spmd import call


@pytest.mark.parametrize(("seed", "teams"), [(0, False), (1, True)])
def test_programs(seed, teams, only_kernels, monkeypatch):
    """A fault shows as other numbers, or as a loop without end; `batch_eval/random_programs.py --tables` runs more of them."""
    monkeypatch.setattr(call, "QUICK", 30_000)
    assert [said for said in judged([Case.of(seed, teams)]) if said not in ("", "ill-conditioned")] == []
