// Steps of a fluid.
#pragma once

#include <cstdint>
#include <tuple>

#include "base/arrays.h"
#include "colliders/arrays.h"

namespace animtool {

// state, pressures, impulses on bodies, mean compression
using FluidStepResult = std::tuple<Out<double, 3>, Out<double, 1>, Out<double, 3>, double>;
FluidStepResult fluid_steps(ColliderArrays colliders, In<std::int32_t, 1> owners,
                            In<double, 2> bodies, In<double, 3> state, In<double, 2> accelerations,
                            double spacing, double density, double viscosity, double tension,
                            double sound_speed, double step, std::int64_t substeps);

Out<double, 1> fluid_densities(ColliderArrays colliders, In<double, 2> points, double spacing);
double fluid_area(In<double, 2> points, double spacing);

}  // namespace animtool
