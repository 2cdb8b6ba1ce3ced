"""Several answers of each target, from the shell."""

import csv

import numpy as np
import pytest

import jaxik
from jaxik.cli.ik import IKArguments


@pytest.mark.parametrize("solutions", [3, "all"])
def test_several_answers(tmp_path, monkeypatch, capsys, solutions):
    monkeypatch.chdir(tmp_path)
    chain = jaxik.load("irb120")
    q = np.random.default_rng(1).uniform(chain.lower, chain.upper, (3, 6))
    poses = np.stack([np.asarray(jaxik.forward_kinematics(chain, row)) for row in q])
    poses[1, 0, 3] += 9.0
    np.savez("targets.npz", poses=poses)
    IKArguments(robot="irb120", targets="targets.npz", solutions=solutions, out=tmp_path / "ik.csv").run()
    IKArguments(robot="irb120", targets="targets.npz", solutions=solutions, out=tmp_path / "ik.npz").run()
    rows = list(csv.DictReader((tmp_path / "ik.csv").read_text().splitlines()))
    with np.load("ik.npz", allow_pickle=False) as arrays:
        counts, answers = arrays["num_solutions"], arrays["solutions"]
    assert counts[1] == 0 and min(counts[[0, 2]]) > 1 and (solutions == "all" or max(counts) <= 3)
    assert [(row["target"], row["solution"]) for row in rows if row["target"] == "2"] == [("2", "0")]
    assert f"{sum(counts)} answers" in capsys.readouterr().out
    for i in (0, 2):
        of_it = [row for row in rows if row["target"] == str(i + 1)]
        assert [row["solution"] for row in of_it] == [str(k + 1) for k in range(counts[i])]
        written = np.array([[float(row[name]) for name in chain.joint_names] for row in of_it])
        assert np.array_equal(written, answers[i, : counts[i]])
        for row in written:
            np.testing.assert_allclose(jaxik.forward_kinematics(chain, row), poses[i], atol=1e-9)
