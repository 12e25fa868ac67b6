// Tolerances of contacts.
#pragma once

#include <limits>

namespace animtool::collide {

constexpr double INF = std::numeric_limits<double>::infinity();

// Distance below which a particle touches a surface [m].
constexpr double TOUCH_DISTANCE = 1e-9;
// Depth above which a particle starts a step inside [m].
constexpr double INSIDE_DEPTH = 1e-6;
// Smallest distance that a particle without a radius keeps from a two-sided surface [m], so that
// its position tells on which side it is.
constexpr double MIN_TWO_SIDED_DISTANCE = 1e-7;

}  // namespace animtool::collide
