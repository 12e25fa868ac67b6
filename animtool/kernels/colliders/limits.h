// What counts as touching.
#pragma once

namespace animtool::collide {

// Nearer than this is touching [m].
constexpr double TOUCH = 1e-9;
// A particle that is deeper than this [m] at the start of a step is inside.
constexpr double INSIDE = 1e-6;
// What has no size keeps at least this from a surface with two sides [m]: by the side that it
// is on then it is told where it came from.
constexpr double SHELL = 1e-7;

}  // namespace animtool::collide
