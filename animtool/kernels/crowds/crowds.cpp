// A step of agents that walk: velocities without collisions ahead, and none that overlap.
//
// Each agent takes half of what a pair must change (van den Berg et al., Reciprocal n-body
// collision avoidance, 2011); what then still overlaps is moved apart (Weiss et al., Position-
// based multi-agent dynamics, 2017).
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <vector>

#include "base/checks.h"
#include "crowds/crowds.h"
#include "particles/neighbours.h"

namespace animtool {

namespace {

constexpr double TINY = 1e-12;
// Two half-planes whose normals are this parallel do not bound each other's line.
constexpr double PARALLEL = 1e-9;
// Agents walk in the same direction if the cosine of their preferred directions exceeds this.
constexpr double SAME_DIRECTION = 0.7;
// Fraction of its speed above which an agent counts as walking along with, against, or across
// another.
constexpr double ALONG = 0.5;
// An agent slower than this fraction of its preferred speed is stuck, and pushes by this fraction
// of it; likewise against oncoming agents.
constexpr double STUCK = 0.3, SHOVE = 0.5, PRESSED = 0.8, PRESSES = 1.0;
// Then it follows this much closer, and looks ahead at least this fraction of the default time.
constexpr double CLOSER = 0.6, SHORTEST = 0.25;
// Lanes to each side of the current one, one agent wide; cost of each lane farther away; and cost
// of the lanes between, over that of walking in them.
constexpr int LANES = 3;
constexpr double STRAY = 0.3, ACROSS = 0.3;
// Costs that differ by less are equal: rounding must not choose a lane.
constexpr double SAME_COST = 1e-9;
// Fraction of its speed at which an agent changes lanes: for each width, and at most.
constexpr double SLANT = 0.44, MAX_SLANT = 0.7;
// An agent blocked by oncoming ones turns its shoulders: fully if the gap to one of them is zero,
// not at all above this, over its width; and, below this fraction of its preferred speed, the more
// the slower it is.
constexpr double SHOULDER_GAP = 0.6, BLOCKED = 0.7;
// Largest penetration of a lane into a wall, over the agent's width.
constexpr double GRAZE = 0.23;

// Modes of agents: they walk, others walk around them, or they are invisible to others.
enum AgentMode : std::uint8_t { WALKS = 0, STAYS = 1, GONE = 2 };

struct Vec2 {
  double x = 0, y = 0;

  Vec2 operator+(const Vec2& b) const { return {x + b.x, y + b.y}; }
  Vec2 operator-(const Vec2& b) const { return {x - b.x, y - b.y}; }
  Vec2 operator*(double s) const { return {x * s, y * s}; }
  Vec2& operator+=(const Vec2& b) { return x += b.x, y += b.y, *this; }
  Vec2& operator-=(const Vec2& b) { return x -= b.x, y -= b.y, *this; }
  double dot(const Vec2& b) const { return x * b.x + y * b.y; }
  double length() const { return std::sqrt(dot(*this)); }
};

Vec2 vec2(const double* from) { return {from[0], from[1]}; }

// A half-plane of velocities: the component along a unit normal is at least a limit.
struct HalfPlane {
  Vec2 normal;
  double limit;
};

// Linear programme: the velocity in a disc and in half-planes that is nearest to a preferred one,
// or farthest in a direction.
class VelocityProgram {
 public:
  explicit VelocityProgram(double max_speed) : max_speed_(max_speed) {}

  // Returns the number of satisfied half-planes: all, or those before the first infeasible one.
  std::size_t solve(const HalfPlane* planes, std::size_t count, const Vec2& desired, bool direction,
                    Vec2& v) const {
    v = desired;
    const double size = desired.length();
    if (direction || size > max_speed_) v = desired * (size > TINY ? max_speed_ / size : 0.0);
    for (std::size_t i = 0; i < count; ++i) {
      if (planes[i].normal.dot(v) >= planes[i].limit) continue;
      if (!solve_on_line(planes, i, desired, direction, v)) return i;
    }
    return count;
  }

 private:
  bool solve_on_line(const HalfPlane* planes, std::size_t i, const Vec2& desired, bool direction,
                     Vec2& v) const {
    const Vec2 normal = planes[i].normal, along{-normal.y, normal.x};
    const double squared_half_chord = max_speed_ * max_speed_ - planes[i].limit * planes[i].limit;
    if (squared_half_chord < 0) return false;
    double high = std::sqrt(squared_half_chord), low = -high;
    for (std::size_t j = 0; j < i; ++j) {
      const double slope = planes[j].normal.dot(along);
      const double deficit = planes[j].limit - planes[j].normal.dot(normal) * planes[i].limit;
      if (std::fabs(slope) < PARALLEL) {
        if (deficit > PARALLEL) return false;
      } else if (slope > 0) {
        low = std::max(low, deficit / slope);
      } else {
        high = std::min(high, deficit / slope);
      }
    }
    if (low > high) return false;
    const double t = desired.dot(along);
    v = normal * planes[i].limit +
        along * (direction ? (t > 0 ? high : low) : std::clamp(t, low, high));
    return true;
  }

  double max_speed_;
};

// If no velocity satisfies all half-planes: the one that violates those after the first `hard` the
// least, and satisfies these.
void least_violation(const VelocityProgram& program, const std::vector<HalfPlane>& planes,
                     std::size_t hard, std::size_t first, std::vector<HalfPlane>& bisectors,
                     Vec2& v) {
  double violation = 0;
  for (std::size_t i = std::max(first, hard); i < planes.size(); ++i) {
    if (planes[i].limit - planes[i].normal.dot(v) <= violation) continue;
    bisectors.assign(planes.begin(), planes.begin() + static_cast<std::ptrdiff_t>(hard));
    for (std::size_t j = hard; j < i; ++j) {
      const Vec2 normal = planes[j].normal - planes[i].normal;
      const double size = normal.length();
      if (size < PARALLEL) continue;
      bisectors.push_back({normal * (1 / size), (planes[j].limit - planes[i].limit) / size});
    }
    Vec2 relaxed;
    if (program.solve(bisectors.data(), bisectors.size(), planes[i].normal, true, relaxed) ==
        bisectors.size())
      v = relaxed;
    violation = planes[i].limit - planes[i].normal.dot(v);
  }
}

struct Rules {
  double sight, horizon, space, push, headway, side, step;
  std::size_t nearest;
};

struct Agents {
  const Neighbours& grid;
  const double *points, *velocities, *preferred, *radii, *max_speeds, *yielding, *shoulders;
  double depth;
  const std::int32_t *groups, *starts;
  const double* walls;
  const std::uint8_t* modes;

  // Distance from the middle of agent i to its outline along a unit vector: a disc, or an ellipse
  // of the same depth if its shoulders are turned.
  double half_width(std::size_t i, const Vec2& direction) const {
    const Vec2 line = vec2(shoulders + 2 * i);
    const double amount = line.length();
    if (amount < TINY) return radii[i];
    const double along = line.dot(direction) / amount, square = std::min(along * along, 1.0);
    return radii[i] *
           (1 - std::min(amount, 1.0) * (1 - std::sqrt(square + depth * depth * (1 - square))));
  }

  bool turned(std::size_t i) const { return shoulders[2 * i] != 0 || shoulders[2 * i + 1] != 0; }

  // Smallest distance of two agents, given the offset of the other.
  double min_distance(std::size_t i, std::size_t j, const Vec2& off, double squared) const {
    if ((!turned(i) && !turned(j)) || !(squared > 0)) return radii[i] + radii[j];
    const Vec2 direction = off * (1 / std::sqrt(squared));
    return half_width(i, direction) + half_width(j, direction);
  }
};

class Walker {
 public:
  Walker(const Rules& rules, const Agents& agents) : rules_(rules), agents_(agents) {}

  Vec2 velocity(std::size_t self, const std::int32_t* hit, const std::int32_t* end) {
    find_neighbours(self, hit, end);
    planes_.clear();
    for (std::int32_t k = agents_.starts[self]; k < agents_.starts[self + 1]; ++k) {
      const double* wall = agents_.walls + 4 * static_cast<std::size_t>(k);
      planes_.push_back({vec2(wall), wall[2]});
    }
    const std::size_t hard = planes_.size();
    const Vec2 velocity = vec2(agents_.velocities + 2 * self);
    // Blocked agents look less far ahead: all would stop if each avoided the others.
    const double preferred_speed = std::max(vec2(agents_.preferred + 2 * self).length(), TINY);
    const double least = blended(1, SHORTEST);
    horizon_ = std::max(
        rules_.horizon * std::clamp(velocity.length() / preferred_speed, least, 1.0), rules_.step);
    for (const Neighbour& one : neighbours_) avoid(self, velocity, one);
    const VelocityProgram program(agents_.max_speeds[self]);
    Vec2 v;
    const Vec2 desired = steered(self);
    const std::size_t satisfied = program.solve(planes_.data(), planes_.size(), desired, false, v);
    if (satisfied < planes_.size())
      least_violation(program, planes_, hard, satisfied, bisectors_, v);
    pressed_ = pressed(self, velocity);
    const double speed = v.length();
    const double min_speed = blended(STUCK, PRESSED) * desired.length();
    if (speed < min_speed) v += (desired - v) * (blended(SHOVE, PRESSES) * (1 - speed / min_speed));
    return v;
  }

  // Shoulder yaw of the last agent, 0 to 1: negative if the other is on its right.
  double pressed() const { return pressed_; }

 private:
  struct Neighbour {
    Vec2 off;
    double squared;
    std::size_t which;
  };

  // The nearest oncoming or crossing agent decides; an agent as close as only turned shoulders
  // allow stays turned.
  double pressed(std::size_t self, const Vec2& velocity) const {
    const Vec2 desired = vec2(agents_.preferred + 2 * self);
    const double preferred_speed = desired.length(),
                 yaw = vec2(agents_.shoulders + 2 * self).length();
    if (preferred_speed < TINY && yaw < TINY) return 0;
    const Vec2 forward = desired * (preferred_speed > TINY ? 1 / preferred_speed : 0.0);
    const double slow = 1 - velocity.dot(forward) / (BLOCKED * std::max(preferred_speed, TINY));
    const double blocked = preferred_speed > TINY ? std::clamp(slow, 0.0, 1.0) : 0.0;
    double most = 0, side = 1;
    for (const Neighbour& one : neighbours_) {
      const double wide = agents_.radii[self] + agents_.radii[one.which];
      const double gap = std::sqrt(one.squared) - wide;
      const Vec2 other = vec2(agents_.preferred + 2 * one.which);
      const bool against = other.dot(forward) < ALONG * other.length();
      const double near = std::clamp(1 - gap / (SHOULDER_GAP * wide), 0.0, 1.0);
      double strength = against ? blocked * near : 0.0;
      if (gap < 0) strength = std::max(strength, yaw);
      if (strength > most) most = strength, side = one.off.dot(left_of(forward)) < 0 ? -1 : 1;
    }
    return side * most;
  }

  // A value without oncoming agents, and with many.
  double blended(double alone, double crowded) const {
    return alone + (crowded - alone) * crossing_;
  }

  void find_neighbours(std::size_t self, const std::int32_t* hit, const std::int32_t* end) {
    neighbours_.clear();
    costs_.fill(0);
    crossing_ = 0;
    const Vec2 here = vec2(agents_.points + 2 * self);
    const Vec2 desired = vec2(agents_.preferred + 2 * self);
    const double speed = desired.length(), wide = 2 * agents_.radii[self];
    // Along in ranges of sight, sideways in widths, and speed along.
    const bool walks = speed > TINY && wide > 0;
    const Vec2 forward = desired * (walks ? 1 / speed : 0.0);
    const Vec2 near = forward * (1 / rules_.sight), fast = forward * (walks ? 1 / speed : 0.0);
    const Vec2 sideways = left_of(forward) * (walks ? 1 / wide : 0.0);
    for (; hit < end; ++hit) {
      const std::size_t which =
          static_cast<std::size_t>(agents_.grid.index()[static_cast<std::size_t>(*hit)]);
      if (which == self || agents_.modes[which] == GONE) continue;
      const Vec2 off = vec2(agents_.points + 2 * which) - here;
      insert_sorted({off, off.dot(off), which});
      const double along = off.dot(near);
      if (along > 0) add_cost(off.dot(sideways), 1 - along, which, fast);
    }
    crossing_ = std::min(crossing_, 1.0);
  }

  // Keeps the nearest in order; of two at equal distance, the first.
  void insert_sorted(const Neighbour& one) {
    const auto nearer = [](const Neighbour& a, const Neighbour& b) {
      return a.squared != b.squared ? a.squared < b.squared : a.which < b.which;
    };
    if (neighbours_.size() < rules_.nearest) {
      neighbours_.push_back(one);
    } else if (neighbours_.empty() || !nearer(one, neighbours_.back())) {
      return;
    }
    std::size_t at = neighbours_.size() - 1;
    for (; at > 0 && nearer(one, neighbours_[at - 1]); --at) neighbours_[at] = neighbours_[at - 1];
    neighbours_[at] = one;
  }

  // To the left of z is x.
  static Vec2 left_of(const Vec2& forward) { return {forward.y, -forward.x}; }

  // Adds the cost of walking in the lanes of an agent ahead: higher the nearer, and the slower
  // along or the faster against.
  void add_cost(double sideways, double near, std::size_t which, const Vec2& fast) {
    // One extra lane on each side, so that both lanes an agent covers exist.
    const double slot = sideways + (LANES + 1);
    if (!(slot >= 0 && slot < 2 * LANES + 2)) return;
    const double preferred_speed = vec2(agents_.preferred + 2 * which).dot(fast);
    const double mean_speed =
        0.5 * (preferred_speed + vec2(agents_.velocities + 2 * which).dot(fast));
    const double cost = near * std::clamp(1 - mean_speed, 0.0, 2.0);
    // A standing agent is no stream.
    if (preferred_speed < ALONG && vec2(agents_.preferred + 2 * which).length() > TINY)
      crossing_ += near;
    const int lane = static_cast<int>(slot);
    const double second = cost * (slot - lane);
    costs_[static_cast<std::size_t>(lane)] += cost - second;
    costs_[static_cast<std::size_t>(lane) + 1] += second;
  }

  // Offset to the left of the cheapest lane, in widths: not inside a wall, and by the preferred
  // side.
  double lane(std::size_t self, const Vec2& forward) const {
    const Vec2 here = vec2(agents_.points + 2 * self), left = left_of(forward);
    const double wide = 2 * agents_.radii[self];
    double least = costs_[LANES + 1], best = 0;
    for (const int direction : {-1, 1}) {
      double across = 0;
      for (int k = 1; k <= LANES; ++k) {
        const double off = direction * k,
                     lane_cost = costs_[static_cast<std::size_t>(LANES + 1 + direction * k)];
        if (!open(self, here + left * (off * wide))) break;
        const double cost = lane_cost + STRAY * k + across - rules_.side * crossing_ * off;
        if (cost < least - SAME_COST) least = cost, best = off;
        across += ACROSS * lane_cost;
      }
    }
    return best;
  }

  bool open(std::size_t self, const Vec2& there) const {
    for (std::int32_t k = agents_.starts[self]; k < agents_.starts[self + 1]; ++k) {
      const double* wall = agents_.walls + 4 * static_cast<std::size_t>(k);
      if (vec2(wall).dot(there) < wall[3] - GRAZE * 2 * agents_.radii[self]) return false;
    }
    return true;
  }

  // The preferred velocity: slower behind agents in the same direction, away from near ones, and
  // against oncoming ones in the cheapest lane.
  Vec2 steered(std::size_t self) const {
    Vec2 desired = vec2(agents_.preferred + 2 * self);
    const double speed = desired.length(), radius = agents_.radii[self];
    const Vec2 forward = desired * (speed > TINY ? 1 / speed : 0.0);
    const double headway = rules_.headway * blended(1, CLOSER);
    double most = speed;
    Vec2 away;
    for (const Neighbour& one : neighbours_) {
      const double far = std::sqrt(one.squared), wide = radius + agents_.radii[one.which];
      const double gap = std::max(far - wide, 0.0);
      const double along = one.off.dot(forward);
      if (headway > 0 && along > 0 && one.squared - along * along < wide * wide) {
        const Vec2 other = vec2(agents_.preferred + 2 * one.which);
        // Not if the other sees this one ahead of it, too.
        if (other.dot(forward) > SAME_DIRECTION * other.length() && one.off.dot(other) >= 0)
          most = std::min(most, gap / headway);
      }
      const bool together =
          agents_.groups[self] >= 0 && agents_.groups[self] == agents_.groups[one.which];
      if (gap < rules_.space && far > TINY && !together)
        away -= one.off * (rules_.push * (1 - gap / rules_.space) / far);
    }
    if (crossing_ == 0) return forward * most + away;
    const double slant = std::clamp(SLANT * lane(self, forward), -MAX_SLANT, MAX_SLANT);
    return forward * most + left_of(forward) * (slant * speed) + away;
  }

  // The half-plane of velocities of the reciprocal avoidance of two agents.
  void avoid(std::size_t self, const Vec2& velocity, const Neighbour& one) {
    const double wide = agents_.min_distance(self, one.which, one.off, one.squared);
    const Vec2 relative = velocity - vec2(agents_.velocities + 2 * one.which);
    const bool distinct = one.squared > wide * wide;
    const double time = distinct ? horizon_ : rules_.step;
    // From the centre of the disc that truncates the collision cone.
    const Vec2 off = relative - one.off * (1 / time);
    const double forward = off.dot(one.off), size = off.length();
    Vec2 normal, change;
    if (!distinct || (forward < 0 && forward * forward > wide * wide * size * size)) {
      if (size > TINY) {
        normal = off * (1 / size);
      } else {
        // Two at the same position with equal velocities: the direction depends on their indices
        // alone.
        normal = {self < one.which ? -1.0 : 1.0, 0};
      }
      change = normal * (wide / time - size);
    } else {
      const double leg = std::sqrt(one.squared - wide * wide), over = 1 / one.squared;
      const double cross = one.off.x * off.y - one.off.y * off.x;
      const double side = cross > 0 ? wide : -wide;
      const Vec2 edge{(one.off.x * leg - one.off.y * side) * over,
                      (one.off.x * side + one.off.y * leg) * over};
      normal = cross > 0 ? Vec2{-edge.y, edge.x} : Vec2{edge.y, -edge.x};
      change = edge * relative.dot(edge) - relative;
    }
    const double fraction = agents_.modes[one.which] == WALKS ? 0.5 : 1.0;
    planes_.push_back({normal, normal.dot(velocity + change * fraction)});
  }

  const Rules& rules_;
  const Agents& agents_;
  std::vector<Neighbour> neighbours_;
  std::array<double, 2 * LANES + 3> costs_;
  double crossing_ = 0;  // number of oncoming or crossing agents, weighted by distance: 1 at most
  double horizon_ = 0, pressed_ = 0;
  std::vector<HalfPlane> planes_, bisectors_;
};

struct Pair {
  std::int32_t one, other;
};

// Moves agents apart, and out of walls, until none overlaps another by more than `tolerance`.
// Returns the largest remaining overlap.
double separate(const Agents& agents, Vec2* moved, const std::vector<Pair>& pairs,
                std::size_t count, std::int64_t max_passes, double tolerance) {
  double worst = 0;
  for (std::int64_t pass = 0; pass <= max_passes; ++pass) {
    worst = 0;
    const bool last = pass == max_passes;
    for (const Pair& pair : pairs) {
      const std::size_t i = static_cast<std::size_t>(pair.one),
                        j = static_cast<std::size_t>(pair.other);
      const Vec2 off = moved[j] - moved[i];
      const double squared = off.dot(off);
      const double wide = agents.min_distance(i, j, off, squared);
      if (squared >= wide * wide) continue;
      const double far = std::sqrt(squared), deficit = wide - far;
      worst = std::max(worst, deficit);
      const double a = agents.yielding[i] * (agents.modes[i] == WALKS);
      const double b = agents.yielding[j] * (agents.modes[j] == WALKS);
      if (last || a + b == 0) continue;
      const Vec2 direction = far > TINY ? off * (1 / far) : Vec2{1, 0};
      moved[i] -= direction * (deficit * a / (a + b));
      moved[j] += direction * (deficit * b / (a + b));
    }
    for (std::size_t i = 0; i < count; ++i)
      for (std::int32_t k = agents.starts[i]; k < agents.starts[i + 1]; ++k) {
        const double* wall = agents.walls + 4 * static_cast<std::size_t>(k);
        const double deficit = wall[3] - vec2(wall).dot(moved[i]);
        if (deficit <= 0 || agents.modes[i] != WALKS) continue;
        worst = std::max(worst, deficit);
        if (!last) moved[i] += vec2(wall) * deficit;
      }
    if (worst <= tolerance) break;
  }
  return worst;
}

}  // namespace

CrowdStepped crowd_step(const CrowdStep& options) {
  const auto& [points, velocities, preferred, radii, max_speeds, yielding, shoulders, depth, groups,
               modes, starts, walls, sight, nearest, horizon, space, push, headway, side, step,
               max_passes, tolerance] = options;
  const std::size_t count = points.shape(0);
  check::at_most("points", count, check::MAX_ROWS);
  check::shape("points", points, {check::ANY, 2});
  check::shape("velocities", velocities, {count, 2});
  check::shape("preferred", preferred, {count, 2});
  check::shape("radii", radii, {count});
  check::shape("max_speeds", max_speeds, {count});
  check::shape("yielding", yielding, {count});
  check::numbers("shoulders", shoulders, {count, 2});
  check::between("depth", depth, 0, 1);
  check::shape("groups", groups, {count});
  check::shape("modes", modes, {count});
  check::shape("starts", starts, {count + 1});
  check::shape("walls", walls, {check::ANY, 4});
  check::starts("starts", starts, walls.shape(0));
  for (const auto* one : {&points, &velocities, &preferred, &walls}) check::finite("points", *one);
  check::finite("radii", radii);
  check::finite("max_speeds", max_speeds);
  for (std::size_t i = 0; i < count; ++i) check::positive("yielding", yielding.data()[i]);
  check::positive("sight", sight);
  check::between("nearest", nearest, 0, 1000);
  check::positive("horizon", horizon);
  check::not_negative("space", space);
  check::finite("push", push);
  check::not_negative("headway", headway);
  check::between("side", side, -1, 1);
  check::positive("step", step);
  check::between("max_passes", max_passes, 0, 10000);
  check::not_negative("tolerance", tolerance);
  Out<double, 2> out(count, 2), speeds(count, 2);
  Out<double, 1> pressed(count);
  double worst = 0;
  const double open[3] = {0, 0, 0};
  const Block<double> flat = block<double>(3 * count);
  double widest = 0;
  for (std::size_t i = 0; i < count; ++i) {
    flat[3 * i] = points.data()[2 * i];
    flat[3 * i + 1] = 0;
    flat[3 * i + 2] = points.data()[2 * i + 1];
    widest = std::max(widest, radii.data()[i]);
  }
  const double anyone = std::numeric_limits<double>::infinity();
  const Block<Vec2> moved = block<Vec2>(count);
  const Rules rules{sight,   horizon, space, push,
                    headway, side,    step,  static_cast<std::size_t>(nearest)};
  const Neighbours grid(flat.get(), nullptr, count, sight, open, open);
  const Agents agents{grid,         points.data(),     velocities.data(), preferred.data(),
                      radii.data(), max_speeds.data(), yielding.data(),   shoulders.data(),
                      depth,        groups.data(),     starts.data(),     walls.data(),
                      modes.data()};
  Walker walker(rules, agents);
  grid.visit_all<false>(
      anyone, [&](std::size_t i, const double*, const std::int32_t* hit, const std::int32_t* end) {
        const std::size_t which = static_cast<std::size_t>(grid.index()[i]);
        const bool walks = agents.modes[which] == WALKS;
        const Vec2 v = walks ? walker.velocity(which, hit, end) : Vec2();
        pressed.get()[which] = walks ? walker.pressed() : 0.0;
        moved[which] = vec2(agents.points + 2 * which) + v * step;
      });
  for (std::size_t i = 0; i < count; ++i) flat[3 * i] = moved[i].x, flat[3 * i + 2] = moved[i].y;
  // Pushed agents collide with others that were near.
  const double near = 2 * widest * 1.25;
  std::vector<Pair> pairs;
  if (near > 0) {
    const Neighbours close(flat.get(), nullptr, count, near, open, open);
    close.visit_all<true>(anyone, [&](std::size_t i, const double*, const std::int32_t* hit,
                                      const std::int32_t* end) {
      const std::int32_t* index = close.index();
      if (modes.data()[index[i]] == GONE) return;
      for (; hit < end; ++hit)
        if (modes.data()[index[*hit]] != GONE) pairs.push_back({index[i], index[*hit]});
    });
  }
  worst = separate(agents, moved.get(), pairs, count, max_passes, tolerance);
  for (std::size_t i = 0; i < count; ++i) {
    const Vec2 v = (moved[i] - vec2(agents.points + 2 * i)) * (1 / step);
    out.get()[2 * i] = moved[i].x, out.get()[2 * i + 1] = moved[i].y;
    speeds.get()[2 * i] = v.x, speeds.get()[2 * i + 1] = v.y;
  }
  return {std::move(out), std::move(speeds), worst, std::move(pressed)};
}

namespace {

// A node, and its distance from the seeds.
struct QueuedNode {
  double distance;
  std::int64_t node;

  bool operator>(const QueuedNode& b) const {
    return distance != b.distance ? distance > b.distance : node > b.node;
  }
};

}  // namespace

// The fast marching method (Sethian, A fast marching level set method, 1996).
Out<double, 2> travel_distances(In<bool, 2> free, double cell, In<std::int64_t, 1> seeds,
                                In<double, 1> starts) {
  const std::size_t rows = free.shape(0), columns = free.shape(1), count = rows * columns;
  check::at_most("free", count, check::MAX_ROWS);
  check::positive("cell", cell);
  check::indices("seeds", seeds, 0, static_cast<std::int64_t>(count));
  check::numbers("starts", starts, {seeds.shape(0)});
  Out<double, 2> out(rows, columns);
  constexpr double never = std::numeric_limits<double>::infinity();
  double* distances = out.get();
  std::fill_n(distances, count, never);
  std::vector<std::uint8_t> done(count, 0);
  std::vector<QueuedNode> heap;
  const auto reach = [&](std::size_t node, double distance) {
    if (!free.data()[node] || done[node] || distance >= distances[node]) return;
    distances[node] = distance;
    heap.push_back({distance, static_cast<std::int64_t>(node)});
    std::push_heap(heap.begin(), heap.end(), std::greater<>());
  };
  for (std::size_t k = 0; k < seeds.shape(0); ++k)
    reach(static_cast<std::size_t>(seeds.data()[k]), starts.data()[k]);
  const auto at = [&](std::size_t row, std::size_t column, int down, int right) {
    const std::size_t r = row + static_cast<std::size_t>(down),
                      c = column + static_cast<std::size_t>(right);
    return r < rows && c < columns && done[r * columns + c] ? distances[r * columns + c] : never;
  };
  // From the nearer neighbour of each axis: |grad d| = 1.
  const auto solve = [&](std::size_t row, std::size_t column) {
    const double a = std::min(at(row, column, -1, 0), at(row, column, 1, 0));
    const double b = std::min(at(row, column, 0, -1), at(row, column, 0, 1));
    if (std::fabs(a - b) >= cell || a == never || b == never) return std::min(a, b) + cell;
    return (a + b + std::sqrt(2 * cell * cell - (a - b) * (a - b))) / 2;
  };
  while (!heap.empty()) {
    const std::size_t node = static_cast<std::size_t>(heap.front().node);
    std::pop_heap(heap.begin(), heap.end(), std::greater<>());
    heap.pop_back();
    if (done[node]) continue;
    done[node] = 1;
    const std::size_t row = node / columns, column = node % columns;
    if (row > 0) reach(node - columns, solve(row - 1, column));
    if (row + 1 < rows) reach(node + columns, solve(row + 1, column));
    if (column > 0) reach(node - 1, solve(row, column - 1));
    if (column + 1 < columns) reach(node + 1, solve(row, column + 1));
  }
  return out;
}

}  // namespace animtool
