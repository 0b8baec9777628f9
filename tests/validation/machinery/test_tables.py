from __future__ import annotations

from validation.machinery.tables import by


def test_numbers_have_means_and_texts_counts_by_group_with_the_first_seed_of_each() -> None:
    rows = [
        {"seed": 3, "scope": "path", "fit": {"at": [1.0, 2.0], "is_good": True}, "said": ["late"], "seconds": 1.0},
        {"seed": 4, "scope": "path", "fit": {"at": [3.0, 2.0], "is_good": False}, "said": ["late", "off"]},
        {"seed": 5, "scope": "array", "steps": [{"size": 1.0}, {"size": 0.5}], "said": [""]},
    ]
    assert by("scope")(rows) == [
        "| | array | path |",
        "|---|---|---|",
        "| trials | 1 | 2 |",
        "| steps.size | 0.75 |  |",
        "| said |  | late 2 (seed 3), off 1 (seed 4) |",
        "| fit.at.0 |  | 2 |",
        "| fit.at.1 |  | 2 |",
        "| fit.is_good |  | 0.5 |",
    ]
