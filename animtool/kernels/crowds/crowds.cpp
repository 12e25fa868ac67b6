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
constexpr double ALIKE = 0.7;
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
constexpr double SLANT = 0.44, MOST_SLANT = 0.7;
// An agent blocked by oncoming ones turns its shoulders: fully if the gap to one of them is zero,
// not at all above this, over its width; and, below this fraction of its preferred speed, the more
// the slower it is.
constexpr double TURNS_FROM = 0.6, HELD_UP = 0.7;
// Largest penetration of a lane into a wall, over the agent's width.
constexpr double GRAZE = 0.23;

// Modes of agents: they walk, others walk around them, or they are invisible to others.
enum Does : std::uint8_t { WALKS = 0, STAYS = 1, GONE = 2 };

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
class Chooser {
 public:
  explicit Chooser(double most) : most_(most) {}

  // Returns the number of satisfied half-planes: all, or those before the first infeasible one.
  std::size_t choose(const HalfPlane* planes, std::size_t count, const Vec2& wanted, bool way,
                     Vec2& v) const {
    v = wanted;
    const double size = wanted.length();
    if (way || size > most_) v = wanted * (size > TINY ? most_ / size : 0.0);
    for (std::size_t i = 0; i < count; ++i) {
      if (planes[i].normal.dot(v) >= planes[i].limit) continue;
      if (!on_line(planes, i, wanted, way, v)) return i;
    }
    return count;
  }

 private:
  bool on_line(const HalfPlane* planes, std::size_t i, const Vec2& wanted, bool way,
               Vec2& v) const {
    const Vec2 normal = planes[i].normal, along{-normal.y, normal.x};
    const double room = most_ * most_ - planes[i].limit * planes[i].limit;
    if (room < 0) return false;
    double high = std::sqrt(room), low = -high;
    for (std::size_t j = 0; j < i; ++j) {
      const double slope = planes[j].normal.dot(along);
      const double lack = planes[j].limit - planes[j].normal.dot(normal) * planes[i].limit;
      if (std::fabs(slope) < PARALLEL) {
        if (lack > PARALLEL) return false;
      } else if (slope > 0) {
        low = std::max(low, lack / slope);
      } else {
        high = std::min(high, lack / slope);
      }
    }
    if (low > high) return false;
    const double t = wanted.dot(along);
    v = normal * planes[i].limit + along * (way ? (t > 0 ? high : low) : std::clamp(t, low, high));
    return true;
  }

  double most_;
};

// If no velocity satisfies all half-planes: the one that violates those after the first `hard` the
// least, and satisfies these.
void least_outside(const Chooser& chooser, const std::vector<HalfPlane>& planes,
                   std::size_t hard, std::size_t first, std::vector<HalfPlane>& between, Vec2& v) {
  double outside = 0;
  for (std::size_t i = std::max(first, hard); i < planes.size(); ++i) {
    if (planes[i].limit - planes[i].normal.dot(v) <= outside) continue;
    between.assign(planes.begin(), planes.begin() + static_cast<std::ptrdiff_t>(hard));
    for (std::size_t j = hard; j < i; ++j) {
      const Vec2 normal = planes[j].normal - planes[i].normal;
      const double size = normal.length();
      if (size < PARALLEL) continue;
      between.push_back({normal * (1 / size), (planes[j].limit - planes[i].limit) / size});
    }
    Vec2 found;
    if (chooser.choose(between.data(), between.size(), planes[i].normal, true, found) ==
        between.size())
      v = found;
    outside = planes[i].limit - planes[i].normal.dot(v);
  }
}

struct Rules {
  double sight, horizon, space, push, headway, side, step;
  std::size_t nearest;
};

struct Agents {
  const Neighbours& grid;
  const double *points, *velocities, *preferred, *radii, *most, *gives, *shoulders;
  double depth;
  const std::int32_t *groups, *starts;
  const double* walls;
  const std::uint8_t* does;

  // Distance from the middle of agent i to its outline along a unit vector: a disc, or an ellipse
  // of the same depth if its shoulders are turned.
  double half(std::size_t i, const Vec2& way) const {
    const Vec2 line = vec2(shoulders + 2 * i);
    const double much = line.length();
    if (much < TINY) return radii[i];
    const double along = line.dot(way) / much, square = std::min(along * along, 1.0);
    return radii[i] * (1 - std::min(much, 1.0) * (1 - std::sqrt(square + depth * depth * (1 - square))));
  }

  bool turned(std::size_t i) const { return shoulders[2 * i] != 0 || shoulders[2 * i + 1] != 0; }

  // Smallest distance of two agents, given the offset of the other.
  double wide(std::size_t i, std::size_t j, const Vec2& off, double squared) const {
    if ((!turned(i) && !turned(j)) || !(squared > 0)) return radii[i] + radii[j];
    const Vec2 way = off * (1 / std::sqrt(squared));
    return half(i, way) + half(j, way);
  }
};

class Walker {
 public:
  Walker(const Rules& rules, const Agents& agents) : rules_(rules), agents_(agents) {}

  Vec2 velocity(std::size_t self, const std::int32_t* hit, const std::int32_t* end) {
    look(self, hit, end);
    planes_.clear();
    for (std::int32_t k = agents_.starts[self]; k < agents_.starts[self + 1]; ++k) {
      const double* wall = agents_.walls + 4 * static_cast<std::size_t>(k);
      planes_.push_back({vec2(wall), wall[2]});
    }
    const std::size_t hard = planes_.size();
    const Vec2 own = vec2(agents_.velocities + 2 * self);
    // Blocked agents look less far ahead: all would stop if each avoided the others.
    const double likes = std::max(vec2(agents_.preferred + 2 * self).length(), TINY);
    const double least = between(1, SHORTEST);
    horizon_ = std::max(rules_.horizon * std::clamp(own.length() / likes, least, 1.0), rules_.step);
    for (const Seen& one : seen_) avoid(self, own, one);
    const Chooser chooser(agents_.most[self]);
    Vec2 v;
    const Vec2 wanted = wish(self);
    const std::size_t met = chooser.choose(planes_.data(), planes_.size(), wanted, false, v);
    if (met < planes_.size()) least_outside(chooser, planes_, hard, met, between_, v);
    pressed_ = pressed(self, own);
    const double speed = v.length();
    const double most = between(STUCK, PRESSED) * wanted.length();
    if (speed < most) v += (wanted - v) * (between(SHOVE, PRESSES) * (1 - speed / most));
    return v;
  }

  // Shoulder yaw of the last agent, 0 to 1: negative if the other is on its right.
  double pressed() const { return pressed_; }

 private:
  struct Seen {
    Vec2 off;
    double squared;
    std::size_t which;
  };

  // The nearest oncoming or crossing agent decides; an agent as close as only turned shoulders
  // allow stays turned.
  double pressed(std::size_t self, const Vec2& own) const {
    const Vec2 wanted = vec2(agents_.preferred + 2 * self);
    const double likes = wanted.length(), turn = vec2(agents_.shoulders + 2 * self).length();
    if (likes < TINY && turn < TINY) return 0;
    const Vec2 ahead = wanted * (likes > TINY ? 1 / likes : 0.0);
    const double slow = 1 - own.dot(ahead) / (HELD_UP * std::max(likes, TINY));
    const double held = likes > TINY ? std::clamp(slow, 0.0, 1.0) : 0.0;
    double most = 0, side = 1;
    for (const Seen& one : seen_) {
      const double wide = agents_.radii[self] + agents_.radii[one.which];
      const double gap = std::sqrt(one.squared) - wide;
      const Vec2 other = vec2(agents_.preferred + 2 * one.which);
      const bool against = other.dot(ahead) < ALONG * other.length();
      const double near = std::clamp(1 - gap / (TURNS_FROM * wide), 0.0, 1.0);
      double much = against ? held * near : 0.0;
      if (gap < 0) much = std::max(much, turn);
      if (much > most) most = much, side = one.off.dot(left_of(ahead)) < 0 ? -1 : 1;
    }
    return side * most;
  }

  // A value without oncoming agents, and with many.
  double between(double alone, double met) const { return alone + (met - alone) * met_; }

  void look(std::size_t self, const std::int32_t* hit, const std::int32_t* end) {
    seen_.clear();
    costs_.fill(0);
    met_ = 0;
    const Vec2 here = vec2(agents_.points + 2 * self);
    const Vec2 wanted = vec2(agents_.preferred + 2 * self);
    const double speed = wanted.length(), wide = 2 * agents_.radii[self];
    // Along in ranges of sight, sideways in widths, and speed along.
    const bool walks = speed > TINY && wide > 0;
    const Vec2 ahead = wanted * (walks ? 1 / speed : 0.0);
    const Vec2 near = ahead * (1 / rules_.sight), fast = ahead * (walks ? 1 / speed : 0.0);
    const Vec2 aside = left_of(ahead) * (walks ? 1 / wide : 0.0);
    for (; hit < end; ++hit) {
      const std::size_t which =
          static_cast<std::size_t>(agents_.grid.index()[static_cast<std::size_t>(*hit)]);
      if (which == self || agents_.does[which] == GONE) continue;
      const Vec2 off = vec2(agents_.points + 2 * which) - here;
      keep({off, off.dot(off), which});
      const double along = off.dot(near);
      if (along > 0) weigh(off.dot(aside), 1 - along, which, fast);
    }
    met_ = std::min(met_, 1.0);
  }

  // Keeps the nearest in order; of two at equal distance, the first.
  void keep(const Seen& one) {
    const auto nearer = [](const Seen& a, const Seen& b) {
      return a.squared != b.squared ? a.squared < b.squared : a.which < b.which;
    };
    if (seen_.size() < rules_.nearest) {
      seen_.push_back(one);
    } else if (seen_.empty() || !nearer(one, seen_.back())) {
      return;
    }
    std::size_t at = seen_.size() - 1;
    for (; at > 0 && nearer(one, seen_[at - 1]); --at) seen_[at] = seen_[at - 1];
    seen_[at] = one;
  }

  // To the left of z is x.
  static Vec2 left_of(const Vec2& ahead) { return {ahead.y, -ahead.x}; }

  // Adds the cost of walking in the lanes of an agent ahead: higher the nearer, and the slower
  // along or the faster against.
  void weigh(double aside, double near, std::size_t which, const Vec2& fast) {
    // One extra lane on each side, so that both lanes an agent covers exist.
    const double place = aside + (LANES + 1);
    if (!(place >= 0 && place < 2 * LANES + 2)) return;
    const double likes = vec2(agents_.preferred + 2 * which).dot(fast);
    const double goes = 0.5 * (likes + vec2(agents_.velocities + 2 * which).dot(fast));
    const double cost = near * std::clamp(1 - goes, 0.0, 2.0);
    // A standing agent is no stream.
    if (likes < ALONG && vec2(agents_.preferred + 2 * which).length() > TINY) met_ += near;
    const int lane = static_cast<int>(place);
    const double second = cost * (place - lane);
    costs_[static_cast<std::size_t>(lane)] += cost - second;
    costs_[static_cast<std::size_t>(lane) + 1] += second;
  }

  // Offset to the left of the cheapest lane, in widths: not inside a wall, and by the preferred
  // side.
  double lane(std::size_t self, const Vec2& ahead) const {
    const Vec2 here = vec2(agents_.points + 2 * self), left = left_of(ahead);
    const double wide = 2 * agents_.radii[self];
    double least = costs_[LANES + 1], best = 0;
    for (const int way : {-1, 1}) {
      double across = 0;
      for (int k = 1; k <= LANES; ++k) {
        const double off = way * k, own = costs_[static_cast<std::size_t>(LANES + 1 + way * k)];
        if (!open(self, here + left * (off * wide))) break;
        const double cost = own + STRAY * k + across - rules_.side * met_ * off;
        if (cost < least - SAME_COST) least = cost, best = off;
        across += ACROSS * own;
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
  Vec2 wish(std::size_t self) const {
    Vec2 wanted = vec2(agents_.preferred + 2 * self);
    const double speed = wanted.length(), own = agents_.radii[self];
    const Vec2 ahead = wanted * (speed > TINY ? 1 / speed : 0.0);
    const double headway = rules_.headway * between(1, CLOSER);
    double most = speed;
    Vec2 away;
    for (const Seen& one : seen_) {
      const double far = std::sqrt(one.squared), wide = own + agents_.radii[one.which];
      const double gap = std::max(far - wide, 0.0);
      const double along = one.off.dot(ahead);
      if (headway > 0 && along > 0 && one.squared - along * along < wide * wide) {
        const Vec2 other = vec2(agents_.preferred + 2 * one.which);
        // Not if the other sees this one ahead of it, too.
        if (other.dot(ahead) > ALIKE * other.length() && one.off.dot(other) >= 0)
          most = std::min(most, gap / headway);
      }
      const bool together =
          agents_.groups[self] >= 0 && agents_.groups[self] == agents_.groups[one.which];
      if (gap < rules_.space && far > TINY && !together)
        away -= one.off * (rules_.push * (1 - gap / rules_.space) / far);
    }
    if (met_ == 0) return ahead * most + away;
    const double slant = std::clamp(SLANT * lane(self, ahead), -MOST_SLANT, MOST_SLANT);
    return ahead * most + left_of(ahead) * (slant * speed) + away;
  }

  // The half-plane of velocities of the reciprocal avoidance of two agents.
  void avoid(std::size_t self, const Vec2& own, const Seen& one) {
    const double wide = agents_.wide(self, one.which, one.off, one.squared);
    const Vec2 relative = own - vec2(agents_.velocities + 2 * one.which);
    const bool apart = one.squared > wide * wide;
    const double time = apart ? horizon_ : rules_.step;
    // From the centre of the disc that truncates the collision cone.
    const Vec2 off = relative - one.off * (1 / time);
    const double ahead = off.dot(one.off), size = off.length();
    Vec2 normal, change;
    if (!apart || (ahead < 0 && ahead * ahead > wide * wide * size * size)) {
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
      const double turn = cross > 0 ? wide : -wide;
      const Vec2 edge{(one.off.x * leg - one.off.y * turn) * over,
                      (one.off.x * turn + one.off.y * leg) * over};
      normal = cross > 0 ? Vec2{-edge.y, edge.x} : Vec2{edge.y, -edge.x};
      change = edge * relative.dot(edge) - relative;
    }
    const double share = agents_.does[one.which] == WALKS ? 0.5 : 1.0;
    planes_.push_back({normal, normal.dot(own + change * share)});
  }

  const Rules& rules_;
  const Agents& agents_;
  std::vector<Seen> seen_;
  std::array<double, 2 * LANES + 3> costs_;
  double met_ = 0;  // number of oncoming or crossing agents, weighted by distance: 1 at most
  double horizon_ = 0, pressed_ = 0;
  std::vector<HalfPlane> planes_, between_;
};

struct Pair {
  std::int32_t one, other;
};

// Moves agents apart, and out of walls, until none overlaps another by more than `enough`. Returns
// the largest remaining overlap.
double separate(const Agents& agents, Vec2* moved, const std::vector<Pair>& pairs,
                std::size_t count, std::int64_t rounds, double enough) {
  double worst = 0;
  for (std::int64_t round = 0; round <= rounds; ++round) {
    worst = 0;
    const bool last = round == rounds;
    for (const Pair& pair : pairs) {
      const std::size_t i = static_cast<std::size_t>(pair.one),
                        j = static_cast<std::size_t>(pair.other);
      const Vec2 off = moved[j] - moved[i];
      const double squared = off.dot(off);
      const double wide = agents.wide(i, j, off, squared);
      if (squared >= wide * wide) continue;
      const double far = std::sqrt(squared), lack = wide - far;
      worst = std::max(worst, lack);
      const double a = agents.gives[i] * (agents.does[i] == WALKS);
      const double b = agents.gives[j] * (agents.does[j] == WALKS);
      if (last || a + b == 0) continue;
      const Vec2 way = far > TINY ? off * (1 / far) : Vec2{1, 0};
      moved[i] -= way * (lack * a / (a + b));
      moved[j] += way * (lack * b / (a + b));
    }
    for (std::size_t i = 0; i < count; ++i)
      for (std::int32_t k = agents.starts[i]; k < agents.starts[i + 1]; ++k) {
        const double* wall = agents.walls + 4 * static_cast<std::size_t>(k);
        const double lack = wall[3] - vec2(wall).dot(moved[i]);
        if (lack <= 0 || agents.does[i] != WALKS) continue;
        worst = std::max(worst, lack);
        if (!last) moved[i] += vec2(wall) * lack;
      }
    if (worst <= enough) break;
  }
  return worst;
}

}  // namespace

CrowdStepped crowd_step(const CrowdStep& given) {
  const auto& [points, velocities, preferred, radii, most, gives, shoulders, depth, groups, does,
               starts, walls,
               sight, nearest, horizon, space, push, headway, side, step, rounds, enough] = given;
  const std::size_t count = points.shape(0);
  check::at_most("points", count, check::MOST_ROWS);
  check::shape("points", points, {check::ANY, 2});
  check::shape("velocities", velocities, {count, 2});
  check::shape("preferred", preferred, {count, 2});
  check::shape("radii", radii, {count});
  check::shape("most", most, {count});
  check::shape("gives", gives, {count});
  check::numbers("shoulders", shoulders, {count, 2});
  check::between("depth", depth, 0, 1);
  check::shape("groups", groups, {count});
  check::shape("does", does, {count});
  check::shape("starts", starts, {count + 1});
  check::shape("walls", walls, {check::ANY, 4});
  check::starts("starts", starts, walls.shape(0));
  for (const auto* one : {&points, &velocities, &preferred, &walls}) check::finite("points", *one);
  check::finite("radii", radii);
  check::finite("most", most);
  for (std::size_t i = 0; i < count; ++i) check::positive("gives", gives.data()[i]);
  check::positive("sight", sight);
  check::between("nearest", nearest, 0, 1000);
  check::positive("horizon", horizon);
  check::not_negative("space", space);
  check::finite("push", push);
  check::not_negative("headway", headway);
  check::between("side", side, -1, 1);
  check::positive("step", step);
  check::between("rounds", rounds, 0, 10000);
  check::not_negative("enough", enough);
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
  const Rules rules{sight, horizon, space, push, headway, side, step,
                    static_cast<std::size_t>(nearest)};
  const Neighbours grid(flat.get(), nullptr, count, sight, open, open);
  const Agents agents{grid,          points.data(), velocities.data(), preferred.data(),
                      radii.data(), most.data(), gives.data(), shoulders.data(), depth,
                      groups.data(), starts.data(), walls.data(), does.data()};
  Walker walker(rules, agents);
  grid.visit_places<false>(anyone, [&](std::size_t i, const double*, const std::int32_t* hit,
                                       const std::int32_t* end) {
    const std::size_t which = static_cast<std::size_t>(grid.index()[i]);
    const bool walks = agents.does[which] == WALKS;
    const Vec2 v = walks ? walker.velocity(which, hit, end) : Vec2();
    pressed.get()[which] = walks ? walker.pressed() : 0.0;
    moved[which] = vec2(agents.points + 2 * which) + v * step;
  });
  for (std::size_t i = 0; i < count; ++i)
    flat[3 * i] = moved[i].x, flat[3 * i + 2] = moved[i].y;
  // Pushed agents collide with others that were near.
  const double near = 2 * widest * 1.25;
  std::vector<Pair> pairs;
  if (near > 0) {
    const Neighbours close(flat.get(), nullptr, count, near, open, open);
    close.visit_places<true>(anyone, [&](std::size_t i, const double*, const std::int32_t* hit,
                                         const std::int32_t* end) {
      const std::int32_t* index = close.index();
      if (does.data()[index[i]] == GONE) return;
      for (; hit < end; ++hit)
        if (does.data()[index[*hit]] != GONE) pairs.push_back({index[i], index[*hit]});
    });
  }
  worst = separate(agents, moved.get(), pairs, count, rounds, enough);
  for (std::size_t i = 0; i < count; ++i) {
    const Vec2 v = (moved[i] - vec2(agents.points + 2 * i)) * (1 / step);
    out.get()[2 * i] = moved[i].x, out.get()[2 * i + 1] = moved[i].y;
    speeds.get()[2 * i] = v.x, speeds.get()[2 * i + 1] = v.y;
  }
  return {std::move(out), std::move(speeds), worst, std::move(pressed)};
}

namespace {

// A node, and its distance from the seeds.
struct Reached {
  double distance;
  std::int64_t node;

  bool operator>(const Reached& b) const {
    return distance != b.distance ? distance > b.distance : node > b.node;
  }
};

}  // namespace

// The fast marching method (Sethian, A fast marching level set method, 1996).
Out<double, 2> travel_distances(In<bool, 2> free, double cell, In<std::int64_t, 1> seeds,
                                In<double, 1> starts) {
  const std::size_t rows = free.shape(0), columns = free.shape(1), count = rows * columns;
  check::at_most("free", count, check::MOST_ROWS);
  check::positive("cell", cell);
  check::indices("seeds", seeds, 0, static_cast<std::int64_t>(count));
  check::numbers("starts", starts, {seeds.shape(0)});
  Out<double, 2> out(rows, columns);
  constexpr double never = std::numeric_limits<double>::infinity();
  double* distances = out.get();
  std::fill_n(distances, count, never);
  std::vector<std::uint8_t> done(count, 0);
  std::vector<Reached> heap;
  const auto reach = [&](std::size_t node, double distance) {
    if (!free.data()[node] || done[node] || distance >= distances[node]) return;
    distances[node] = distance;
    heap.push_back({distance, static_cast<std::int64_t>(node)});
    std::push_heap(heap.begin(), heap.end(), std::greater<>());
  };
  for (std::size_t k = 0; k < seeds.shape(0); ++k)
    reach(static_cast<std::size_t>(seeds.data()[k]), starts.data()[k]);
  const auto at = [&](std::size_t row, std::size_t column, int down, int right) {
    const std::size_t r = row + static_cast<std::size_t>(down), c = column + static_cast<std::size_t>(right);
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
