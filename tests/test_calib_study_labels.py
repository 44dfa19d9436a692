"""What cases are called: by what differs, so that no two cells of a table or lines of a figure have the same name."""

from dataclasses import replace

import pytest

pytest.importorskip("pyarrow")

from calib.study.description import GaussianNoise, UniformNoise
from calib.study.labels import Labels, noise_kinds
from calib.study.scene import Case

CASE = Case(0, 0, "cube", "A", "usual", None, "quiet", "ours-2", 100, "once")


def named(*cases: Case) -> list[tuple[str, str]]:
    labels = Labels.of(cases)
    return [(labels.row(case), labels.column(case)) for case in cases]


def test_what_all_share_is_not_told():
    assert named(CASE, replace(CASE, method="joint")) == [("Ours-2 (all pairs)", "quiet"), ("joint", "quiet")]


@pytest.mark.parametrize(
    ("changed", "row", "column"),
    [
        ({"array": "ring"}, "Ours-2 (all pairs), array ring", "quiet"),
        ({"board": "B"}, "Ours-2 (all pairs), board B", "quiet"),
        ({"pose_set": "far"}, "Ours-2 (all pairs), pose set far", "quiet"),
        ({"noise": "loud"}, "Ours-2 (all pairs)", "loud"),
        ({"n_poses": 6}, "Ours-2 (all pairs)", "6 poses"),
        ({"n_poses": 6, "noise": "loud"}, "Ours-2 (all pairs), noise loud", "6 poses"),
        ({"starts": "each repetition"}, "Ours-2 (all pairs), start drawn each repetition", "quiet"),
        ({"starts": "each repetition", "method": "joint"}, "joint", "quiet"),
    ],
)
def test_what_differs_is_told(changed, row, column):
    first, second = named(CASE, replace(CASE, **changed))
    assert second == (row, column)
    assert first != second


def test_noises_that_differ_in_scale_only_are_of_one_kind():
    quiet = GaussianNoise(law="gaussian", scale_s=1e-6)
    noises = {
        "quiet": quiet,
        "loud": GaussianNoise(law="gaussian", scale_s=1e-5),
        "biased": UniformNoise(law="uniform", scale_s=1e-5),
        "off": GaussianNoise(law="gaussian", scale_s=1e-6, buzzer_std_m=0.003),
    }
    kinds = noise_kinds(noises)
    assert kinds == {"quiet": "gaussian", "loud": "gaussian", "biased": "uniform", "off": "gaussian, buzzers 3 mm off"}
    assert noise_kinds({"quiet": quiet}) == {"quiet": ""}
