// What counts as touching.
#pragma once

namespace animtool::collide {

// Nearer than this is touching [m].
constexpr double TOUCH = 1e-9;
// A particle that is deeper than this [m] at the start of a step is inside.
constexpr double INSIDE = 1e-6;

}  // namespace animtool::collide
