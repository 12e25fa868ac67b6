"""Joins unlabelled runs of one marker across gaps."""

from __future__ import annotations

import numpy as np

from animtool.capture.markers.geometry import MarkerDistances
from animtool.core.array_types import FloatArray, IntArray

# Likelihood of distances between points for pairs of markers.

# Distances of two markers on one segment equal those at rest up to noise and skin
# motion [m], which grows with their spread; and the probability of one segment falls
# with that spread [m].
DISTANCE_NOISE, SKIN_FACTOR, SAME_SEGMENT_PRIOR, LOOSE_SPREAD = 0.0007, 0.7, 0.5, 0.003
# Tolerance of other pairs: a fraction of their rest distance, and a minimum [m].
JOINT_PLAY_FRACTION, MIN_PLAY = 0.25, 0.015
# Probability density of distances between unrelated points [1/m], and the minimum
# density of any pair.
UNRELATED_DENSITY, MIN_DENSITY = 1.0, 0.05
# Of pairs on different segments, near ones and steady ones are weighted more [m].
FAR_DISTANCE, UNSTEADY_SPREAD = 0.25, 0.02


def rest_evidence(
    mean: FloatArray, spread: FloatArray, rest_distances: FloatArray
) -> FloatArray:
    """Return the evidence [nat] that distances are those of pairs at rest ``(..., M)``.

    It compares each distance's likelihood for the rest pair with that for arbitrary
    points. It is 0 where a distance is unknown.

    mean, spread: Mean and spread of observed distances ``(...)`` [m]. rest_distances:
    ``(M,)`` or ``(..., M)``.
    """
    is_known = np.isfinite(mean)
    mean = np.where(is_known, mean, 0.0)[..., None]
    spread = np.where(is_known, spread, 1.0)[..., None]
    deviation = mean - rest_distances
    rigid_tolerance = DISTANCE_NOISE + SKIN_FACTOR * spread
    same_segment = SAME_SEGMENT_PRIOR / (1.0 + (spread / LOOSE_SPREAD) ** 2)
    rigid_density = same_segment / (
        np.pi * rigid_tolerance * (1.0 + (deviation / rigid_tolerance) ** 2)
    )
    loose_tolerance = MIN_PLAY + spread + JOINT_PLAY_FRACTION * rest_distances
    loose_density = (1.0 - same_segment) / (
        np.pi * loose_tolerance * (1.0 + (deviation / loose_tolerance) ** 2)
    ) + MIN_DENSITY
    weight = 1.0 / (
        (1.0 + (mean / FAR_DISTANCE) ** 2) * (1.0 + (spread / UNSTEADY_SPREAD) ** 2)
    )
    log_likelihood = weight * np.log(loose_density / UNRELATED_DENSITY) + np.log1p(
        rigid_density / loose_density
    )
    return np.asarray(
        np.where(is_known[..., None] & np.isfinite(rest_distances), log_likelihood, 0.0)
    )


# Minimum evidence for joining two runs, and its margin over any other run that is
# visible at the same time as one of them [nat].
MIN_CHAIN_EVIDENCE, MIN_CHAIN_MARGIN = 3.0, 1.5


def chain_runs(distances: MarkerDistances, overlap: FloatArray) -> IntArray:
    """Join runs that are the same marker; return each run's chain ``(R,)``, from 0.

    Two runs are joined if they keep the same distances to everything visible with both,
    and no concurrent run matches either nearly as well. Runs visible together are never
    one chain.

    distances: Distances of the runs. overlap: Frames in which pairs are visible ``(R,
    R)``.
    """
    run_count = len(overlap)
    chain_of_run = np.arange(run_count)
    likelihood = chain_likelihoods(distances, overlap)
    is_shared = overlap > 0
    likelihood[is_shared] = -np.inf
    is_concurrent = is_shared & ~np.eye(run_count, dtype=bool)
    # Two runs of one marker are each other's best among those visible at the same time
    # as the other.
    candidate_pairs = np.argwhere(likelihood > MIN_CHAIN_EVIDENCE)
    candidate_pairs = candidate_pairs[candidate_pairs[:, 0] < candidate_pairs[:, 1]]
    scored_pairs = []
    for a, b in candidate_pairs.tolist():
        pair_likelihood = likelihood[a, b]
        # the runs that could replace a
        rival_likelihoods_b = likelihood[a][is_concurrent[b]]
        rival_likelihoods_a = likelihood[b][is_concurrent[a]]
        rival_likelihood = max(
            rival_likelihoods_a.max(initial=0.0), rival_likelihoods_b.max(initial=0.0)
        )
        if pair_likelihood > rival_likelihood + MIN_CHAIN_MARGIN:
            scored_pairs.append((pair_likelihood - rival_likelihood, a, b))
    scored_pairs.sort(reverse=True)
    members = {run: [run] for run in range(run_count)}
    for _, a, b in scored_pairs:
        chain_a, chain_b = int(chain_of_run[a]), int(chain_of_run[b])
        if (
            chain_a == chain_b
            or is_shared[np.ix_(members[chain_a], members[chain_b])].any()
        ):
            continue
        members[chain_a] += members.pop(chain_b)
        chain_of_run[members[chain_a]] = chain_a
    return np.unique(chain_of_run, return_inverse=True)[1]


def chain_likelihoods(distances: MarkerDistances, overlap: FloatArray) -> FloatArray:
    """Return the evidence that two runs are the same marker ``(R, R)`` [nat]."""
    run_count = len(overlap)
    likelihood = np.zeros((run_count, run_count))
    for run in range(run_count):
        mean = distances.mean[run]
        # (S, B): mean distances of concurrent points to both runs
        log_likelihood = rest_evidence(mean, distances.spread[run], distances.mean)
        weight = np.minimum(1.0, np.minimum(overlap[run][:, None], overlap) / 60.0)
        is_known = np.isfinite(distances.mean) & np.isfinite(mean)[:, None]
        likelihood[run] = (log_likelihood * weight * is_known).sum(axis=0)
    return 0.5 * (likelihood + likelihood.T)


def merge_chains(points: FloatArray, chain_of_run: IntArray) -> FloatArray:
    """Merge run positions ``(F, R, 3)`` into chain positions ``(F, C, 3)``."""
    merged_points = np.full((len(points), int(chain_of_run.max()) + 1, 3), np.nan)
    for run, chain in enumerate(chain_of_run.tolist()):
        is_visible = np.isfinite(points[:, run, 0])
        merged_points[is_visible, chain] = points[is_visible, run]
    return merged_points
