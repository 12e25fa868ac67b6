// Gravity, molecules and curl noise.
#pragma once

#include <cstdint>
#include <optional>
#include <tuple>

#include "base/arrays.h"

namespace animtool {

std::tuple<Out<double, 2>, Out<double, 1>, Out<double, 1>> gravity(
    In<double, 2> points, In<double, 1> masses, double constant, double softening, double accuracy);

std::tuple<Out<std::int32_t, 1>, Out<std::int64_t, 1>, Out<std::int32_t, 1>> molecule_pairs(
    In<double, 2> points, In<double, 1> box, double radius, std::int64_t max_pairs);

std::tuple<Out<double, 2>, Out<double, 1>, double> molecule_forces(
    In<double, 2> points, In<std::int32_t, 1> order, In<std::int64_t, 1> starts,
    In<std::int32_t, 1> partners, In<double, 1> box, In<std::int32_t, 1> kinds,
    In<double, 3> forces, std::optional<In<double, 1>> charges, double cutoff, double onset,
    double damping);

Out<double, 2> curl_noise(In<double, 2> points, In<double, 1> times, std::uint64_t seed);

}  // namespace animtool
