// A step of walking agents: velocities without imminent collisions, and positions without overlap.
// Each agent makes half of the change that a pair needs (van den Berg et al., Reciprocal n-body
// collision avoidance, 2011). Agents that then still overlap are moved apart (Weiss et al.,
// Position-based multi-agent dynamics, 2017).
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

constexpr double EPSILON = 1e-12;
// Two half-planes whose normals are this parallel do not bound each other's line.
constexpr double PARALLEL_TOLERANCE = 1e-9;
// Two agents walk in the same direction if the cosine of the angle between their preferred
// directions exceeds this.
constexpr double SAME_DIRECTION_COSINE = 0.7;
// An agent walks with another if its speed along that direction exceeds this fraction of its whole
// speed. Otherwise it is oncoming or crossing.
constexpr double MIN_ALONG_FRACTION = 0.5;
// An agent that is slower than STUCK_SPEED_FRACTION, as a fraction of its preferred speed, is
// stuck. Then it pushes with PUSH_FRACTION of the missing velocity. The second pair applies among
// many oncoming agents.
constexpr double STUCK_SPEED_FRACTION = 0.3, PUSH_FRACTION = 0.5,
                 CROWDED_STUCK_SPEED_FRACTION = 0.8, CROWDED_PUSH_FRACTION = 1.0;
// Among many oncoming agents an agent follows at this fraction of its headway, and looks ahead for
// at least this fraction of its horizon.
constexpr double CROWDED_HEADWAY_FACTOR = 0.6, MIN_HORIZON_FRACTION = 0.25;
// The number of lanes on each side of the current one, each one agent wide. The cost of each lane
// farther away. The cost of crossing a lane, as a fraction of the cost of walking in it.
constexpr int WIDTHS_PER_SIDE = 3;
constexpr double DETOUR_COST_PER_WIDTH = 0.3, CROSSING_COST = 0.3;
// Costs that differ by less are equal, so that rounding does not choose a lane.
constexpr double COST_TOLERANCE = 1e-9;
// The sideways speed of an agent that changes lanes, over its speed: for each width, and at most.
constexpr double SLANT_PER_WIDTH = 0.44, MAX_SLANT = 0.7;
// An agent that oncoming agents block turns its shoulders. It turns them fully if the gap to one of
// them is zero, and not at all if the gap exceeds MAX_SHOULDER_GAP_RATIO, as a fraction of the
// width. Below BLOCKED_SPEED_FRACTION, as a fraction of its preferred speed, it turns them more the
// slower it is.
constexpr double MAX_SHOULDER_GAP_RATIO = 0.6, BLOCKED_SPEED_FRACTION = 0.7;
// The largest depth of a lane inside a wall, over the agent's width.
constexpr double MAX_WALL_DEPTH_RATIO = 0.23;

// The mode of an agent: it walks, or it stands and others walk around it, or others do not see it.
enum AgentMode : std::uint8_t { WALKING = 0, STANDING = 1, INVISIBLE = 2 };

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

Vec2 vec2(const double* values) { return {values[0], values[1]}; }

// A half-plane of velocities whose component along a unit normal is at least a limit.
struct HalfPlane {
  Vec2 normal;
  double limit;
};

// A linear programme over the velocities in a disc and in half-planes. It finds the velocity that
// is nearest to a preferred one, or the farthest one in a direction.
class VelocityProgram {
 public:
  explicit VelocityProgram(double max_speed) : max_speed_(max_speed) {}

  // Returns the number of satisfied half-planes: all of them, or those before the first infeasible
  // one.
  std::size_t solve(const HalfPlane* planes, std::size_t count, const Vec2& desired,
                    bool is_direction, Vec2& velocity) const {
    velocity = desired;
    const double desired_speed = desired.length();
    if (is_direction || desired_speed > max_speed_)
      velocity = desired * (desired_speed > EPSILON ? max_speed_ / desired_speed : 0.0);
    for (std::size_t i = 0; i < count; ++i) {
      if (planes[i].normal.dot(velocity) >= planes[i].limit) continue;
      if (!solve_on_line(planes, i, desired, is_direction, velocity)) return i;
    }
    return count;
  }

 private:
  bool solve_on_line(const HalfPlane* planes, std::size_t i, const Vec2& desired, bool is_direction,
                     Vec2& velocity) const {
    const Vec2 normal = planes[i].normal, line_direction{-normal.y, normal.x};
    const double squared_half_chord = max_speed_ * max_speed_ - planes[i].limit * planes[i].limit;
    if (squared_half_chord < 0) return false;
    double high = std::sqrt(squared_half_chord), low = -high;
    for (std::size_t j = 0; j < i; ++j) {
      const double slope = planes[j].normal.dot(line_direction);
      const double deficit = planes[j].limit - planes[j].normal.dot(normal) * planes[i].limit;
      if (std::fabs(slope) < PARALLEL_TOLERANCE) {
        if (deficit > PARALLEL_TOLERANCE) return false;
      } else if (slope > 0) {
        low = std::max(low, deficit / slope);
      } else {
        high = std::min(high, deficit / slope);
      }
    }
    if (low > high) return false;
    const double desired_position = desired.dot(line_direction);
    velocity = normal * planes[i].limit +
               line_direction * (is_direction ? (desired_position > 0 ? high : low)
                                              : std::clamp(desired_position, low, high));
    return true;
  }

  double max_speed_;
};

// If no velocity satisfies all half-planes, finds the one that violates them the least. The first
// `hard_count` half-planes are always satisfied.
void minimize_violation(const VelocityProgram& program, const std::vector<HalfPlane>& planes,
                        std::size_t hard_count, std::size_t first_violated,
                        std::vector<HalfPlane>& bisectors, Vec2& velocity) {
  double violation = 0;
  for (std::size_t i = std::max(first_violated, hard_count); i < planes.size(); ++i) {
    if (planes[i].limit - planes[i].normal.dot(velocity) <= violation) continue;
    bisectors.assign(planes.begin(), planes.begin() + static_cast<std::ptrdiff_t>(hard_count));
    for (std::size_t j = hard_count; j < i; ++j) {
      const Vec2 normal = planes[j].normal - planes[i].normal;
      const double length = normal.length();
      if (length < PARALLEL_TOLERANCE) continue;
      bisectors.push_back({normal * (1 / length), (planes[j].limit - planes[i].limit) / length});
    }
    Vec2 relaxed_velocity;
    if (program.solve(bisectors.data(), bisectors.size(), planes[i].normal, true,
                      relaxed_velocity) == bisectors.size())
      velocity = relaxed_velocity;
    violation = planes[i].limit - planes[i].normal.dot(velocity);
  }
}

struct CrowdRules {
  double sight, horizon, personal_space, separation_speed, headway, preferred_side, time_step;
  std::size_t max_neighbours;
};

struct Agents {
  const Neighbours& grid;
  const double *points, *velocities, *preferred_velocities, *radii, *max_speeds, *yielding,
      *shoulders;
  double depth;
  const std::int32_t *groups, *wall_starts;
  const double* walls;
  const std::uint8_t* modes;

  // Distance from the centre of agent i to its outline along a unit vector. The outline is a disc,
  // or an ellipse with the same depth if the shoulders are turned.
  double half_width(std::size_t i, const Vec2& direction) const {
    const Vec2 shoulder_line = vec2(shoulders + 2 * i);
    const double yaw = shoulder_line.length();
    if (yaw < EPSILON) return radii[i];
    const double cosine = shoulder_line.dot(direction) / yaw,
                 squared_cosine = std::min(cosine * cosine, 1.0);
    return radii[i] *
           (1 - std::min(yaw, 1.0) *
                    (1 - std::sqrt(squared_cosine + depth * depth * (1 - squared_cosine))));
  }

  bool has_shoulder_yaw(std::size_t i) const {
    return shoulders[2 * i] != 0 || shoulders[2 * i + 1] != 0;
  }

  // The smallest distance of two agents, given the offset from the first to the second.
  double min_distance(std::size_t i, std::size_t j, const Vec2& offset,
                      double squared_distance) const {
    if ((!has_shoulder_yaw(i) && !has_shoulder_yaw(j)) || !(squared_distance > 0))
      return radii[i] + radii[j];
    const Vec2 direction = offset * (1 / std::sqrt(squared_distance));
    return half_width(i, direction) + half_width(j, direction);
  }
};

class Walker {
 public:
  Walker(const CrowdRules& rules, const Agents& agents) : rules_(rules), agents_(agents) {}

  Vec2 velocity(std::size_t agent, const std::int32_t* hit, const std::int32_t* end) {
    find_neighbours(agent, hit, end);
    planes_.clear();
    for (std::int32_t k = agents_.wall_starts[agent]; k < agents_.wall_starts[agent + 1]; ++k) {
      const double* wall = agents_.walls + 4 * static_cast<std::size_t>(k);
      planes_.push_back({vec2(wall), wall[2]});
    }
    const std::size_t hard_count = planes_.size();
    const Vec2 velocity = vec2(agents_.velocities + 2 * agent);
    // Blocked agents look less far into the future. Otherwise all would stop, because each would
    // avoid the others.
    const double preferred_speed =
        std::max(vec2(agents_.preferred_velocities + 2 * agent).length(), EPSILON);
    const double min_fraction = blend(1, MIN_HORIZON_FRACTION);
    horizon_ = std::max(
        rules_.horizon * std::clamp(velocity.length() / preferred_speed, min_fraction, 1.0),
        rules_.time_step);
    for (const Neighbour& neighbour : neighbours_) add_avoidance(agent, velocity, neighbour);
    const VelocityProgram program(agents_.max_speeds[agent]);
    Vec2 new_velocity;
    const Vec2 desired = steer(agent);
    const std::size_t satisfied_count =
        program.solve(planes_.data(), planes_.size(), desired, false, new_velocity);
    if (satisfied_count < planes_.size())
      minimize_violation(program, planes_, hard_count, satisfied_count, bisectors_, new_velocity);
    shoulder_yaw_ = find_shoulder_yaw(agent, velocity);
    const double speed = new_velocity.length();
    const double min_speed =
        blend(STUCK_SPEED_FRACTION, CROWDED_STUCK_SPEED_FRACTION) * desired.length();
    if (speed < min_speed)
      new_velocity += (desired - new_velocity) *
                      (blend(PUSH_FRACTION, CROWDED_PUSH_FRACTION) * (1 - speed / min_speed));
    return new_velocity;
  }

  // The target shoulder yaw of the last agent, from -1 to 1. It is negative if the other agent is
  // on its right.
  double shoulder_yaw() const { return shoulder_yaw_; }

 private:
  struct Neighbour {
    Vec2 offset;
    double squared_distance;
    std::size_t index;
  };

  // The nearest oncoming or crossing agent decides. Shoulders stay turned if another agent is so
  // close that only turned shoulders fit.
  double find_shoulder_yaw(std::size_t agent, const Vec2& velocity) const {
    const Vec2 desired = vec2(agents_.preferred_velocities + 2 * agent);
    const double preferred_speed = desired.length(),
                 current_yaw = vec2(agents_.shoulders + 2 * agent).length();
    if (preferred_speed < EPSILON && current_yaw < EPSILON) return 0;
    const Vec2 forward = desired * (preferred_speed > EPSILON ? 1 / preferred_speed : 0.0);
    const double slowness =
        1 - velocity.dot(forward) / (BLOCKED_SPEED_FRACTION * std::max(preferred_speed, EPSILON));
    const double blocked_fraction =
        preferred_speed > EPSILON ? std::clamp(slowness, 0.0, 1.0) : 0.0;
    double max_strength = 0, side = 1;
    for (const Neighbour& neighbour : neighbours_) {
      const double width = agents_.radii[agent] + agents_.radii[neighbour.index];
      const double gap = std::sqrt(neighbour.squared_distance) - width;
      const Vec2 other_velocity = vec2(agents_.preferred_velocities + 2 * neighbour.index);
      const bool is_opposed =
          other_velocity.dot(forward) < MIN_ALONG_FRACTION * other_velocity.length();
      const double proximity = std::clamp(1 - gap / (MAX_SHOULDER_GAP_RATIO * width), 0.0, 1.0);
      double strength = is_opposed ? blocked_fraction * proximity : 0.0;
      if (gap < 0) strength = std::max(strength, current_yaw);
      if (strength > max_strength)
        max_strength = strength, side = neighbour.offset.dot(left_of(forward)) < 0 ? -1 : 1;
    }
    return side * max_strength;
  }

  // Interpolates between a value without oncoming agents and one with many.
  double blend(double uncrowded_value, double crowded_value) const {
    return uncrowded_value + (crowded_value - uncrowded_value) * oncoming_strength_;
  }

  void find_neighbours(std::size_t agent, const std::int32_t* hit, const std::int32_t* end) {
    neighbours_.clear();
    costs_.fill(0);
    oncoming_strength_ = 0;
    const Vec2 position = vec2(agents_.points + 2 * agent);
    const Vec2 desired = vec2(agents_.preferred_velocities + 2 * agent);
    const double speed = desired.length(), width = 2 * agents_.radii[agent];
    // The scales convert offsets along to fractions of the sight, offsets sideways to widths, and
    // velocities to fractions of the speed.
    const bool has_direction = speed > EPSILON && width > 0;
    const Vec2 forward = desired * (has_direction ? 1 / speed : 0.0);
    const Vec2 sight_scale = forward * (1 / rules_.sight),
               speed_scale = forward * (has_direction ? 1 / speed : 0.0);
    const Vec2 sideways = left_of(forward) * (has_direction ? 1 / width : 0.0);
    for (; hit < end; ++hit) {
      const std::size_t other =
          static_cast<std::size_t>(agents_.grid.point_indices()[static_cast<std::size_t>(*hit)]);
      if (other == agent || agents_.modes[other] == INVISIBLE) continue;
      const Vec2 offset = vec2(agents_.points + 2 * other) - position;
      insert_sorted({offset, offset.dot(offset), other});
      const double sight_fraction = offset.dot(sight_scale);
      if (sight_fraction > 0)
        add_cost(offset.dot(sideways), 1 - sight_fraction, other, speed_scale);
    }
    oncoming_strength_ = std::min(oncoming_strength_, 1.0);
  }

  // Keeps the nearest agents in order. Of two at equal distance, the one with the lower index comes
  // first.
  void insert_sorted(const Neighbour& neighbour) {
    const auto nearer = [](const Neighbour& a, const Neighbour& b) {
      return a.squared_distance != b.squared_distance ? a.squared_distance < b.squared_distance
                                                      : a.index < b.index;
    };
    if (neighbours_.size() < rules_.max_neighbours) {
      neighbours_.push_back(neighbour);
    } else if (neighbours_.empty() || !nearer(neighbour, neighbours_.back())) {
      return;
    }
    std::size_t i = neighbours_.size() - 1;
    for (; i > 0 && nearer(neighbour, neighbours_[i - 1]); --i) neighbours_[i] = neighbours_[i - 1];
    neighbours_[i] = neighbour;
  }

  // The positive x axis is to the left of the positive z axis.
  static Vec2 left_of(const Vec2& forward) { return {forward.y, -forward.x}; }

  // Adds the cost of walking in the lanes of another agent. It is higher if the agent is nearer,
  // slower in the same direction, or faster in the opposite direction.
  void add_cost(double sideways, double proximity, std::size_t other, const Vec2& speed_scale) {
    // One extra lane on each side, so that both lanes that an agent covers exist.
    const double position_in_costs = sideways + (WIDTHS_PER_SIDE + 1);
    if (!(position_in_costs >= 0 && position_in_costs < 2 * WIDTHS_PER_SIDE + 2)) return;
    const double preferred_speed = vec2(agents_.preferred_velocities + 2 * other).dot(speed_scale);
    const double mean_speed =
        0.5 * (preferred_speed + vec2(agents_.velocities + 2 * other).dot(speed_scale));
    const double cost = proximity * std::clamp(1 - mean_speed, 0.0, 2.0);
    // A standing agent is not a stream of agents.
    if (preferred_speed < MIN_ALONG_FRACTION &&
        vec2(agents_.preferred_velocities + 2 * other).length() > EPSILON)
      oncoming_strength_ += proximity;
    const int lane = static_cast<int>(position_in_costs);
    const double upper_cost = cost * (position_in_costs - lane);
    costs_[static_cast<std::size_t>(lane)] += cost - upper_cost;
    costs_[static_cast<std::size_t>(lane) + 1] += upper_cost;
  }

  // The offset to the left of the cheapest lane, in widths. The lane is not inside a wall. Lanes on
  // the preferred side cost less.
  double find_cheapest_offset(std::size_t agent, const Vec2& forward) const {
    const Vec2 position = vec2(agents_.points + 2 * agent), left = left_of(forward);
    const double width = 2 * agents_.radii[agent];
    double least_cost = costs_[WIDTHS_PER_SIDE + 1], best_offset = 0;
    for (const int direction : {-1, 1}) {
      double crossing_cost = 0;
      for (int k = 1; k <= WIDTHS_PER_SIDE; ++k) {
        const double offset = direction * k,
                     lane_cost =
                         costs_[static_cast<std::size_t>(WIDTHS_PER_SIDE + 1 + direction * k)];
        if (!is_clear_of_walls(agent, position + left * (offset * width))) break;
        const double cost = lane_cost + DETOUR_COST_PER_WIDTH * k + crossing_cost -
                            rules_.preferred_side * oncoming_strength_ * offset;
        if (cost < least_cost - COST_TOLERANCE) least_cost = cost, best_offset = offset;
        crossing_cost += CROSSING_COST * lane_cost;
      }
    }
    return best_offset;
  }

  bool is_clear_of_walls(std::size_t agent, const Vec2& point) const {
    for (std::int32_t k = agents_.wall_starts[agent]; k < agents_.wall_starts[agent + 1]; ++k) {
      const double* wall = agents_.walls + 4 * static_cast<std::size_t>(k);
      if (vec2(wall).dot(point) < wall[3] - MAX_WALL_DEPTH_RATIO * 2 * agents_.radii[agent])
        return false;
    }
    return true;
  }

  // The preferred velocity: slower behind agents that walk in the same direction, away from near
  // agents, and in the cheapest lane against oncoming agents.
  Vec2 steer(std::size_t agent) const {
    Vec2 desired = vec2(agents_.preferred_velocities + 2 * agent);
    const double speed = desired.length(), radius = agents_.radii[agent];
    const Vec2 forward = desired * (speed > EPSILON ? 1 / speed : 0.0);
    const double headway = rules_.headway * blend(1, CROWDED_HEADWAY_FACTOR);
    double max_speed = speed;
    Vec2 separation;
    for (const Neighbour& neighbour : neighbours_) {
      const double distance = std::sqrt(neighbour.squared_distance),
                   width = radius + agents_.radii[neighbour.index];
      const double gap = std::max(distance - width, 0.0);
      const double forward_distance = neighbour.offset.dot(forward);
      if (headway > 0 && forward_distance > 0 &&
          neighbour.squared_distance - forward_distance * forward_distance < width * width) {
        const Vec2 other_velocity = vec2(agents_.preferred_velocities + 2 * neighbour.index);
        // Does not slow down if the other agent also sees this one in front of itself.
        if (other_velocity.dot(forward) > SAME_DIRECTION_COSINE * other_velocity.length() &&
            neighbour.offset.dot(other_velocity) >= 0)
          max_speed = std::min(max_speed, gap / headway);
      }
      const bool is_same_group =
          agents_.groups[agent] >= 0 && agents_.groups[agent] == agents_.groups[neighbour.index];
      if (gap < rules_.personal_space && distance > EPSILON && !is_same_group)
        separation -= neighbour.offset *
                      (rules_.separation_speed * (1 - gap / rules_.personal_space) / distance);
    }
    if (oncoming_strength_ == 0) return forward * max_speed + separation;
    const double slant =
        std::clamp(SLANT_PER_WIDTH * find_cheapest_offset(agent, forward), -MAX_SLANT, MAX_SLANT);
    return forward * max_speed + left_of(forward) * (slant * speed) + separation;
  }

  // Adds the half-plane of velocities for the reciprocal avoidance of two agents.
  void add_avoidance(std::size_t agent, const Vec2& velocity, const Neighbour& neighbour) {
    const double width =
        agents_.min_distance(agent, neighbour.index, neighbour.offset, neighbour.squared_distance);
    const Vec2 relative_velocity = velocity - vec2(agents_.velocities + 2 * neighbour.index);
    const bool is_separate = neighbour.squared_distance > width * width;
    const double time = is_separate ? horizon_ : rules_.time_step;
    // The offset from the centre of the disc that truncates the collision cone.
    const Vec2 from_disc_centre = relative_velocity - neighbour.offset * (1 / time);
    const double forward = from_disc_centre.dot(neighbour.offset),
                 length = from_disc_centre.length();
    Vec2 normal, change;
    if (!is_separate || (forward < 0 && forward * forward > width * width * length * length)) {
      if (length > EPSILON) {
        normal = from_disc_centre * (1 / length);
      } else {
        // Two agents are at the same position with equal velocities. The direction depends only on
        // their indices.
        normal = {agent < neighbour.index ? -1.0 : 1.0, 0};
      }
      change = normal * (width / time - length);
    } else {
      const double tangent_length = std::sqrt(neighbour.squared_distance - width * width),
                   inverse_squared = 1 / neighbour.squared_distance;
      const double cross =
          neighbour.offset.x * from_disc_centre.y - neighbour.offset.y * from_disc_centre.x;
      const double side = cross > 0 ? width : -width;
      const Vec2 edge{
          (neighbour.offset.x * tangent_length - neighbour.offset.y * side) * inverse_squared,
          (neighbour.offset.x * side + neighbour.offset.y * tangent_length) * inverse_squared};
      normal = cross > 0 ? Vec2{-edge.y, edge.x} : Vec2{edge.y, -edge.x};
      change = edge * relative_velocity.dot(edge) - relative_velocity;
    }
    const double fraction = agents_.modes[neighbour.index] == WALKING ? 0.5 : 1.0;
    planes_.push_back({normal, normal.dot(velocity + change * fraction)});
  }

  const CrowdRules& rules_;
  const Agents& agents_;
  std::vector<Neighbour> neighbours_;
  std::array<double, 2 * WIDTHS_PER_SIDE + 3> costs_;
  double oncoming_strength_ =
      0;  // number of oncoming or crossing agents, weighted by proximity, at most 1
  double horizon_ = 0, shoulder_yaw_ = 0;
  std::vector<HalfPlane> planes_, bisectors_;
};

struct Pair {
  std::int32_t first, second;
};

// Moves agents apart, and out of walls, until no pair overlaps by more than `tolerance`. Returns
// the largest remaining overlap.
double separate(const Agents& agents, Vec2* positions, const std::vector<Pair>& pairs,
                std::size_t count, std::int64_t max_passes, double tolerance) {
  double max_overlap = 0;
  for (std::int64_t pass = 0; pass <= max_passes; ++pass) {
    max_overlap = 0;
    const bool is_last = pass == max_passes;
    for (const Pair& pair : pairs) {
      const std::size_t i = static_cast<std::size_t>(pair.first),
                        j = static_cast<std::size_t>(pair.second);
      const Vec2 offset = positions[j] - positions[i];
      const double squared_distance = offset.dot(offset);
      const double min_distance = agents.min_distance(i, j, offset, squared_distance);
      if (squared_distance >= min_distance * min_distance) continue;
      const double distance = std::sqrt(squared_distance), deficit = min_distance - distance;
      max_overlap = std::max(max_overlap, deficit);
      const double first_yielding = agents.yielding[i] * (agents.modes[i] == WALKING);
      const double second_yielding = agents.yielding[j] * (agents.modes[j] == WALKING);
      if (is_last || first_yielding + second_yielding == 0) continue;
      const Vec2 direction = distance > EPSILON ? offset * (1 / distance) : Vec2{1, 0};
      positions[i] -= direction * (deficit * first_yielding / (first_yielding + second_yielding));
      positions[j] += direction * (deficit * second_yielding / (first_yielding + second_yielding));
    }
    for (std::size_t i = 0; i < count; ++i)
      for (std::int32_t k = agents.wall_starts[i]; k < agents.wall_starts[i + 1]; ++k) {
        const double* wall = agents.walls + 4 * static_cast<std::size_t>(k);
        const double deficit = wall[3] - vec2(wall).dot(positions[i]);
        if (deficit <= 0 || agents.modes[i] != WALKING) continue;
        max_overlap = std::max(max_overlap, deficit);
        if (!is_last) positions[i] += vec2(wall) * deficit;
      }
    if (max_overlap <= tolerance) break;
  }
  return max_overlap;
}

}  // namespace

CrowdStepResult crowd_step(const CrowdStep& options) {
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
  for (const auto* vectors : {&points, &velocities, &preferred, &walls})
    check::finite("points", *vectors);
  check::finite("radii", radii);
  check::finite("max_speeds", max_speeds);
  for (std::size_t i = 0; i < count; ++i) check::positive("yielding", yielding.data()[i]);
  check::positive("sight", sight);
  check::between("nearest", nearest, 0, 1000);
  check::positive("horizon", horizon);
  check::non_negative("space", space);
  check::finite("push", push);
  check::non_negative("headway", headway);
  check::between("side", side, -1, 1);
  check::positive("step", step);
  check::between("max_passes", max_passes, 0, 10000);
  check::non_negative("tolerance", tolerance);
  Out<double, 2> out(count, 2), new_velocities(count, 2);
  Out<double, 1> shoulder_yaws(count);
  double overlap = 0;
  const double no_period[3] = {0, 0, 0};
  const Block<double> flat_points = block<double>(3 * count);
  double max_radius = 0;
  for (std::size_t i = 0; i < count; ++i) {
    flat_points[3 * i] = points.data()[2 * i];
    flat_points[3 * i + 1] = 0;
    flat_points[3 * i + 2] = points.data()[2 * i + 1];
    max_radius = std::max(max_radius, radii.data()[i]);
  }
  const double no_limit = std::numeric_limits<double>::infinity();
  const Block<Vec2> new_points = block<Vec2>(count);
  const CrowdRules rules{sight,   horizon, space, push,
                         headway, side,    step,  static_cast<std::size_t>(nearest)};
  const Neighbours grid(flat_points.get(), nullptr, count, sight, no_period, no_period);
  const Agents agents{grid,         points.data(),     velocities.data(), preferred.data(),
                      radii.data(), max_speeds.data(), yielding.data(),   shoulders.data(),
                      depth,        groups.data(),     starts.data(),     walls.data(),
                      modes.data()};
  Walker walker(rules, agents);
  grid.visit_all<false>(no_limit, [&](std::size_t i, const double*, const std::int32_t* hit,
                                      const std::int32_t* end) {
    const std::size_t agent = static_cast<std::size_t>(grid.point_indices()[i]);
    const bool is_walking = agents.modes[agent] == WALKING;
    const Vec2 velocity = is_walking ? walker.velocity(agent, hit, end) : Vec2();
    shoulder_yaws.get()[agent] = is_walking ? walker.shoulder_yaw() : 0.0;
    new_points[agent] = vec2(agents.points + 2 * agent) + velocity * step;
  });
  for (std::size_t i = 0; i < count; ++i)
    flat_points[3 * i] = new_points[i].x, flat_points[3 * i + 2] = new_points[i].y;
  // Agents that are pushed can collide with others that were near.
  const double pair_distance = 2 * max_radius * 1.25;
  std::vector<Pair> pairs;
  if (pair_distance > 0) {
    const Neighbours near_grid(flat_points.get(), nullptr, count, pair_distance, no_period,
                               no_period);
    near_grid.visit_all<true>(no_limit, [&](std::size_t i, const double*, const std::int32_t* hit,
                                            const std::int32_t* end) {
      const std::int32_t* index = near_grid.point_indices();
      if (modes.data()[index[i]] == INVISIBLE) return;
      for (; hit < end; ++hit)
        if (modes.data()[index[*hit]] != INVISIBLE) pairs.push_back({index[i], index[*hit]});
    });
  }
  overlap = separate(agents, new_points.get(), pairs, count, max_passes, tolerance);
  for (std::size_t i = 0; i < count; ++i) {
    const Vec2 velocity = (new_points[i] - vec2(agents.points + 2 * i)) * (1 / step);
    out.get()[2 * i] = new_points[i].x, out.get()[2 * i + 1] = new_points[i].y;
    new_velocities.get()[2 * i] = velocity.x, new_velocities.get()[2 * i + 1] = velocity.y;
  }
  return {std::move(out), std::move(new_velocities), overlap, std::move(shoulder_yaws)};
}

namespace {

// A grid node and its distance from the seeds.
struct QueuedNode {
  double distance;
  std::int64_t node;

  bool operator>(const QueuedNode& b) const {
    return distance != b.distance ? distance > b.distance : node > b.node;
  }
};

}  // namespace

// The fast marching method (J. A. Sethian, A fast marching level set method for monotonically
// advancing fronts, 1996).
Out<double, 2> travel_distances(In<bool, 2> is_free, double cell_size, In<std::int64_t, 1> seeds,
                                In<double, 1> starts) {
  const std::size_t row_count = is_free.shape(0), column_count = is_free.shape(1),
                    count = row_count * column_count;
  check::at_most("is_free", count, check::MAX_ROWS);
  check::positive("cell_size", cell_size);
  check::indices("seeds", seeds, 0, static_cast<std::int64_t>(count));
  check::numbers("starts", starts, {seeds.shape(0)});
  Out<double, 2> out(row_count, column_count);
  constexpr double INF = std::numeric_limits<double>::infinity();
  double* distances = out.get();
  std::fill_n(distances, count, INF);
  std::vector<std::uint8_t> is_done(count, 0);
  std::vector<QueuedNode> heap;
  const auto relax = [&](std::size_t node, double distance) {
    if (!is_free.data()[node] || is_done[node] || distance >= distances[node]) return;
    distances[node] = distance;
    heap.push_back({distance, static_cast<std::int64_t>(node)});
    std::push_heap(heap.begin(), heap.end(), std::greater<>());
  };
  for (std::size_t k = 0; k < seeds.shape(0); ++k)
    relax(static_cast<std::size_t>(seeds.data()[k]), starts.data()[k]);
  const auto find_distance = [&](std::size_t row, std::size_t column, int down, int right) {
    const std::size_t other_row = row + static_cast<std::size_t>(down),
                      other_column = column + static_cast<std::size_t>(right);
    return other_row < row_count && other_column < column_count &&
                   is_done[other_row * column_count + other_column]
               ? distances[other_row * column_count + other_column]
               : INF;
  };
  // The distance is computed from the nearer neighbour along each axis, so that its gradient has
  // length 1.
  const auto solve = [&](std::size_t row, std::size_t column) {
    const double row_distance =
        std::min(find_distance(row, column, -1, 0), find_distance(row, column, 1, 0));
    const double column_distance =
        std::min(find_distance(row, column, 0, -1), find_distance(row, column, 0, 1));
    if (std::fabs(row_distance - column_distance) >= cell_size || row_distance == INF ||
        column_distance == INF)
      return std::min(row_distance, column_distance) + cell_size;
    return (row_distance + column_distance +
            std::sqrt(2 * cell_size * cell_size -
                      (row_distance - column_distance) * (row_distance - column_distance))) /
           2;
  };
  while (!heap.empty()) {
    const std::size_t node = static_cast<std::size_t>(heap.front().node);
    std::pop_heap(heap.begin(), heap.end(), std::greater<>());
    heap.pop_back();
    if (is_done[node]) continue;
    is_done[node] = 1;
    const std::size_t row = node / column_count, column = node % column_count;
    if (row > 0) relax(node - column_count, solve(row - 1, column));
    if (row + 1 < row_count) relax(node + column_count, solve(row + 1, column));
    if (column > 0) relax(node - 1, solve(row, column - 1));
    if (column + 1 < column_count) relax(node + 1, solve(row, column + 1));
  }
  return out;
}

}  // namespace animtool
