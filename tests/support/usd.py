"""What UsdSkel and USD's own validators say of a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom, UsdSkel, UsdValidation


def skeleton_query(stage: Any) -> Any:
    """Return the query of the one skeleton on a stage."""
    root = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Root))
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root(root), Usd.PrimDefaultPredicate)
    prim = next(p for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton))
    return cache.GetSkelQuery(UsdSkel.Skeleton(prim))


def joint_transforms(stage: Any, codes: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return the joints' world transforms ``(F, J, 4, 4)`` as UsdSkel computes them.

    Its matrices are for row vectors: a transform's place is its last row.
    """
    query = skeleton_query(stage)
    assert query.GetAnimQuery(), "no animation is bound"
    frames = []
    for code in np.asarray(codes, float):
        cache = UsdGeom.XformCache(Usd.TimeCode(code))
        frames.append(np.array(query.ComputeJointWorldTransforms(cache)))
    return np.stack(frames)


def joint_positions(stage: Any, codes: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return world positions ``(F, J, 3)`` of the joints, as UsdSkel computes them."""
    return joint_transforms(stage, codes)[:, :, 3, :3]


def validation_errors(stage: Any) -> list[str]:
    """Return what every registered validator calls an error."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    context = UsdValidation.ValidationContext(validators)
    found = context.Validate(stage)
    return [
        f"{error.GetIdentifier()}: {error.GetMessage()}"
        for error in found
        if error.GetType() == UsdValidation.ValidationErrorType.Error
    ]


def open_stage(path: Path) -> Any:
    """Open a stage."""
    return Usd.Stage.Open(str(path))
