"""tools/bench/paper_tables.py, from a mesh to tables and figures, with tiny budgets."""

from __future__ import annotations

from pathlib import Path

import paper_floor
import paper_tables
import pytest
from click.testing import CliRunner
from paper_report import METHODS, claims_of, load_rows, means


@pytest.fixture
def run(tmp_path: Path, corpus: Path, monkeypatch: pytest.MonkeyPatch, tiny: None):
    monkeypatch.setattr(paper_floor, "SAMPLES", 20_000)
    monkeypatch.setattr("measure.SAMPLES", 2000)
    out = tmp_path / "out"
    options = ["--levels", "1", "--steps", "200", "--share", "0.02", "--resolution", "48", "--preset", "fast"]

    def call(*more: str) -> list[dict[str, str]]:
        done = CliRunner().invoke(
            paper_tables.main,
            [str(out), "spot", *options, "--cache", str(tmp_path / "cache"), *more],
            catch_exceptions=False,
        )
        assert done.exit_code == 0, done.output
        return load_rows(out / "points.tsv")

    return call


@pytest.mark.slow
def test_all_methods_give_rows_tables_and_figures(run, tmp_path: Path) -> None:
    rows = run()
    assert [r["method"] for r in rows] == list(METHODS)
    assert all(float(r["CD"]) > 0 and float(r["CD-paper"]) > 0 and int(r["bytes"]) > 0 for r in rows)
    out = tmp_path / "out"
    for name in ("coverage.tsv", "parameters.tsv", "bytes.tsv", "claims.tsv"):
        assert load_rows(out / name), name
    for name in ("parameters.png", "bytes.png", "renders.png"):
        assert (out / name).stat().st_size > 1000


@pytest.mark.slow
def test_a_second_run_makes_what_is_missing_alone(run, monkeypatch: pytest.MonkeyPatch) -> None:
    first = run("--methods", "vqad")
    monkeypatch.setattr("paper_tables.rival", None)
    assert run("--methods", "vqad") == first
    with pytest.raises(TypeError):
        run("--methods", "vqad", "--seeds", "0,1")


def test_claims_count_cells_and_compare_with_the_best_rival() -> None:
    figures = {"siren_sdf": 4.0, "nglod": 2.0, "paper": 3.0}
    rows = [
        {
            "mesh": "a",
            "method": m,
            "level": "1",
            "seed": s,
            "CD": str(x + d),
            "p99": "1",
            "CD-paper": str(x),
            "normals": "1",
        }
        for m, x in figures.items()
        for s, d in (("0", 0.5), ("1", -0.5))
    ]
    claims = claims_of(means(rows))
    row = next(r for r in claims if (r["method"], r["figure"]) == ("paper", "CD"))
    assert (row["under siren_sdf"], row["under nglod"], row["under all"]) == ("1 of 1", "0 of 1", "1 of 2")
    assert float(row["best rival over it"]) == pytest.approx(2 / 3, rel=1e-3)
