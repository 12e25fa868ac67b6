"""The versions that decide what a batch makes."""

from __future__ import annotations

from functools import cache

PACKAGES = ("animtool", "numpy", "scipy", "usd-core")
GROUPS = ("animtool.passes", "animtool.readers")


@cache
def made_by() -> dict[str, str]:
    """Return the version of each package that decides what is made, plug-ins included.

    A package whose files were changed without another version is taken for the same.

    >>> sorted(made_by())[0]
    'animtool'
    """
    from importlib.metadata import PackageNotFoundError, version

    from animtool.plugins import plugin_points

    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = ""
    for group in GROUPS:
        for point in plugin_points(group).values():
            if point.dist is not None:
                found[point.dist.name] = point.dist.version
    return found
