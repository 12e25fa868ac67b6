// Steps of networks of springs.
#pragma once

#include <optional>
#include <tuple>


#include "springs/contacts.h"
#include "springs/self.h"

namespace animtool {

// Even cells of time, each a number of steps: cell i begins at origin + (first + i) cell.
struct Cells {
  double origin;
  std::int64_t first;
  double cell;
  std::int64_t count;

  double start(std::int64_t i) const {
    return origin + static_cast<double>(first + i) * cell;
  }
};

// Steps of a cell and of a call, at most, and cells from the origin.
constexpr std::int64_t MAX_SUBSTEPS = std::int64_t{1} << 20;
constexpr std::int64_t MAX_STEPS = std::int64_t{1} << 24;
constexpr std::int64_t FARTHEST_CELL = std::int64_t{1} << 52;

// Refuses what has no steps, none that can be told apart, or so many that it is a mistake.
void check_cells(const Cells& cells, std::int64_t substeps);

// states (2, N, 3), torn, particles left inside colliders, and what these were pushed by
// (C, 7): impulse, moment about the origin, and the mass that touched each, at most
using SpringsStepped =
    std::tuple<Out<double, 3>, Out<std::uint8_t, 1>, std::int64_t, Out<double, 2>>;
// states, torn, steps a cell, cells that went well since, largest stretch, steps taken,
// particles in contact and left inside colliders, passages of the surface through itself
// (C, 3), what went through, pushes
using SpringsProjected = std::tuple<Out<double, 3>, Out<std::uint8_t, 1>, int, int, double,
                                    std::int64_t, std::int64_t, std::int64_t,
                                    Out<std::int64_t, 2>, SelfThrough, Out<double, 2>>;
// states, states before, whether these are known, torn, steps, corrections, cells not solved,
// particles left inside colliders, pushes, what pulled those that are held (2, H, 6): impulses
// and moments about the origin of all steps, then of the last; nothing unless asked for
using SpringsSolved = std::tuple<Out<double, 3>, Out<double, 3>, bool, Out<std::uint8_t, 1>,
                                 std::int64_t, std::int64_t, std::int64_t, std::int64_t,
                                 Out<double, 2>, Out<double, 3>>;

Out<std::int64_t, 1> spring_order(In<std::int64_t, 2> ends, std::size_t particles);

Out<double, 2> spring_accelerations(const SpringNetwork& network, double t, double h,
                                    In<double, 3> state, In<std::uint8_t, 1> torn);

// energy [J] of springs, and the largest length over that at rest, 0 of none
std::tuple<double, double> spring_energy(const SpringNetwork& network, In<double, 2> positions);

SpringsStepped step_springs(const SpringNetwork& network, In<double, 3> state,
                            In<std::uint8_t, 1> torn, double origin, std::int64_t first,
                            double cell, std::int64_t cells, int substeps,
                            const std::optional<SpringColliders>& colliders);

SpringsProjected project_springs(const SpringNetwork& network, In<double, 3> state,
                                 In<std::uint8_t, 1> torn, double origin, std::int64_t first,
                                 double cell, std::int64_t cells, int substeps, int calm,
                                 int least, int most, double stretch,
                                 const std::optional<SpringColliders>& colliders,
                                 const SpringLayers* layers, In<std::int64_t, 2> crossed,
                                 double limit);

// One step of what keeps a surface apart from itself, from positions (N, 3) to a state (2, N, 3).
Out<double, 3> part_springs(const SpringNetwork& network, const SpringLayers& layers,
                            In<double, 2> before, In<double, 3> after, double h);

// How many edges go through triangles that have neither of their ends, at positions (N, 3).
std::int64_t pierced_edges(In<double, 2> positions, In<std::int64_t, 2> triangles,
                           const std::optional<In<std::int64_t, 2>>& others);

SpringsSolved solve_springs(const SpringNetwork& network, In<double, 3> state,
                            std::optional<In<double, 3>> before, In<std::uint8_t, 1> torn,
                            double origin, std::int64_t first, double cell,
                            std::int64_t cells, int substeps, bool two_steps,
                            double tolerance,
                            const std::optional<SpringColliders>& colliders,
                            std::optional<In<double, 2>> pulls);

SpringRun begin_springs(const SpringNetwork& network, const In<double, 3>& state,
                        const In<std::uint8_t, 1>& torn);
Out<double, 3> ended_state(const SpringRun& run);
Out<std::uint8_t, 1> ended_torn(const SpringRun& run);

}  // namespace animtool
