"""What is printed of a render, without one."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from vir_addon.cli.report import print_statistics
from vir_addon.core.pass_set import ReflectionStatistics, SetStatistics
from vir_addon.core.settings import ReflectionLookUp


@pytest.mark.parametrize(
    ("look_up", "words"),
    [
        (
            ReflectionLookUp.MARCH,
            "of 1,000 rays 50.0% met a surface, 10.0% one behind others, where something may be nearer, "
            "25.0% one hidden from their map, 15.0% none",
        ),
        (ReflectionLookUp.DIRECTION, "of 1,000 rays, all looked up by direction, 25.0% see a surface, 15.0% none"),
        (ReflectionLookUp.SHADED, "1,000 rays, all looked up by direction;"),
        (ReflectionLookUp.LAZY, "1,000 rays, all looked up by direction, 40 places shaded for them;"),
    ],
)
def test_only_rays_that_are_followed_find_what_is_hidden(look_up, words):
    found = ReflectionStatistics(map_count=2, map_bytes=3 << 20, look_up=look_up.value, ray_count=1000, shaded_count=40)
    found.found_share, found.behind_share, found.by_direction_share, found.left_share = 0.5, 0.1, 0.25, 0.15
    console = Console(file=io.StringIO(), width=1000)
    print_statistics(console, SetStatistics(reflections=found))
    assert words in console.file.getvalue() and ", 3 MiB" in console.file.getvalue()
