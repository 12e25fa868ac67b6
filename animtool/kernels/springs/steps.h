// Solvers for networks of springs.
#pragma once

#include <optional>
#include <tuple>

#include "springs/contacts.h"
#include "springs/self.h"

namespace animtool {

// Equal intervals of time, each of several steps: interval i begins at origin + (first_interval +
// i) duration.
struct IntervalGrid {
  double origin;
  std::int64_t first_interval;
  double duration;
  std::int64_t count;

  double start(std::int64_t i) const {
    return origin + static_cast<double>(first_interval + i) * duration;
  }
};

// Largest number of steps of an interval and of a call, and largest index of an interval.
constexpr std::int64_t MAX_SUBSTEPS = std::int64_t{1} << 20;
constexpr std::int64_t MAX_STEPS = std::int64_t{1} << 24;
constexpr std::int64_t MAX_INTERVAL_INDEX = std::int64_t{1} << 52;

// Refuses intervals without steps, with steps below the resolution of times, or with too many
// steps.
void check_intervals(const IntervalGrid& grid, std::int64_t substeps);

// states (2, N, 3), torn springs, number of particles inside colliders, and impulses on each
// collider (C, 7): impulse, moment about the origin, and the largest mass in contact
using SpringStepResult =
    std::tuple<Out<double, 3>, Out<std::uint8_t, 1>, std::int64_t, Out<double, 2>>;
// states, torn springs, steps per interval, number of calm intervals so far, largest strain, total
// steps, numbers of particles in contact with and inside colliders, intersections of the surface by
// itself (C, 3), their counts, impulses on colliders
using SpringProjectResult =
    std::tuple<Out<double, 3>, Out<std::uint8_t, 1>, int, int, double, std::int64_t, std::int64_t,
               std::int64_t, Out<std::int64_t, 2>, IntersectionCounts, Out<double, 2>>;
// states, previous states, whether these are valid, torn springs, steps, corrections, unsolved
// intervals, number of particles inside colliders, impulses on colliders, and, if requested, on the
// carriers of pinned particles (2, H, 6): impulses and moments about the origin of all steps, then
// of the last
using SpringSolveResult =
    std::tuple<Out<double, 3>, Out<double, 3>, bool, Out<std::uint8_t, 1>, std::int64_t,
               std::int64_t, std::int64_t, std::int64_t, Out<double, 2>, Out<double, 3>>;

// The order in which springs are solved.
Out<std::int64_t, 1> spring_order(In<std::int64_t, 2> ends, std::size_t particles);

// Accelerations of particles at a state (N, 3).
Out<double, 2> spring_accelerations(const SpringNetwork& network, double t, double h,
                                    In<double, 3> state, In<std::uint8_t, 1> is_torn);

// energy of springs [J], and the largest ratio of length to rest length, 0 without springs
std::tuple<double, double> spring_energy(const SpringNetwork& network, In<double, 2> positions);

SpringStepResult step_springs(const SpringNetwork& network, In<double, 3> state,
                              In<std::uint8_t, 1> is_torn, double origin,
                              std::int64_t first_interval, double interval_duration,
                              std::int64_t interval_count, int substeps,
                              const std::optional<SpringColliders>& colliders);

SpringProjectResult project_springs(const SpringNetwork& network, In<double, 3> state,
                                    In<std::uint8_t, 1> is_torn, double origin,
                                    std::int64_t first_interval, double interval_duration,
                                    std::int64_t interval_count, int substeps, int low_strain_count,
                                    int min_substeps, int max_substeps, double repeat_strain,
                                    const std::optional<SpringColliders>& colliders,
                                    const SpringLayers* layers,
                                    In<std::int64_t, 2> initial_intersections, double strain_limit);

// Separates self-contacts in one step from positions (N, 3) to a state (2, N, 3); returns the
// state.
Out<double, 3> part_springs(const SpringNetwork& network, const SpringLayers& layers,
                            In<double, 2> before, In<double, 3> after, double h);

// Number of pairs of an edge and a triangle that it intersects, without a shared particle, at
// positions (N, 3).
std::int64_t pierced_edges(In<double, 2> positions, In<std::int64_t, 2> triangles,
                           const std::optional<In<std::int64_t, 2>>& other_triangles);

SpringSolveResult solve_springs(const SpringNetwork& network, In<double, 3> state,
                                std::optional<In<double, 3>> earlier_state,
                                In<std::uint8_t, 1> is_torn, double origin,
                                std::int64_t first_interval, double interval_duration,
                                std::int64_t interval_count, int substeps, bool uses_bdf2,
                                double tolerance, const std::optional<SpringColliders>& colliders,
                                std::optional<In<double, 2>> last_pin_impulses);

SpringRun build_run(const SpringNetwork& network, const In<double, 3>& state,
                    const In<std::uint8_t, 1>& is_torn);
Out<double, 3> copy_state(const SpringRun& run);
Out<std::uint8_t, 1> copy_torn(const SpringRun& run);

}  // namespace animtool
