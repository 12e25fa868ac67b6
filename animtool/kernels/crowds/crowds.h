// Steps of crowds and flocks.
#pragma once

#include <cstdint>
#include <optional>
#include <tuple>

#include "base/arrays.h"

namespace animtool {

// Agents, their surroundings and the options of a step.
struct CrowdStep {
  In<double, 2> points, velocities, preferred;
  In<double, 1> radii, max_speeds, yielding;
  In<double, 2> shoulders;
  double depth;
  In<std::int32_t, 1> groups;
  In<std::uint8_t, 1> modes;
  In<std::int32_t, 1> starts;
  In<double, 2> walls;
  double sight;
  std::int64_t nearest;
  double horizon, space, push, headway, side, step;
  std::int64_t max_passes;
  double tolerance;
};
// Points, velocities, overlap and shoulder yaws.
using CrowdStepResult = std::tuple<Out<double, 2>, Out<double, 2>, double, Out<double, 1>>;
CrowdStepResult crowd_step(const CrowdStep& options);

Out<double, 2> travel_distances(In<bool, 2> is_free, double cell_size, In<std::int64_t, 1> seeds,
                                In<double, 1> starts);

std::tuple<Out<double, 2>, Out<std::int32_t, 1>, double> flock_accelerations(
    In<double, 2> points, In<double, 2> velocities, std::optional<In<std::int32_t, 1>> members,
    std::optional<In<std::int32_t, 1>> others, double radius, double cosine, std::int64_t nearest,
    In<double, 1> attraction, In<double, 1> alignment, In<double, 1> repulsion, double softening,
    In<double, 2> period, double max_tests);
std::tuple<Out<double, 2>, double> flock_braking(In<double, 2> points, In<double, 2> velocities,
                                                 In<double, 1> min_distances, double sight,
                                                 double min_gap, In<double, 2> period,
                                                 double max_tests);
std::tuple<Out<double, 2>, double, double> flock_separate(In<double, 2> points,
                                                          In<double, 1> min_distances,
                                                          std::int64_t max_passes,
                                                          double relaxation, double clearance,
                                                          In<double, 2> period, double max_tests);

}  // namespace animtool
