#include "rigid/impacts.h"

#include <algorithm>
#include <cmath>

namespace animtool::rigid {

namespace {

// Pairs approaching within this fraction of the fastest are solved together.
constexpr double TOGETHER = 1e-3;
// An impact is converged if velocities change by less than this fraction of the fastest approach.
constexpr double SOLVED = 1e-7;
constexpr int ROUNDS_OF_ONE = 40, ROUNDS_PER_JOINT = 8;
// Largest number of impacts in a substep, in a chain of bodies; the rest is inelastic.
constexpr std::size_t IMPACTS = 16, IMPACTS_PER_PATCH = 4;
// After the first impact, approaches below this fraction of the fastest are ignored too.
constexpr double LITTLE = 0.05;
// Rounding of a sum of energies.
constexpr double EXACT = 1e-13;

}  // namespace

Impacts::Impacts(const World& world, const std::vector<Patch>& patches,
                 const std::vector<Point>& points, const std::vector<std::size_t>& joints,
                 const std::vector<Rows>& rows, std::vector<Speed>& speeds, double tolerance,
                 double soon)
    : world_(world), patches_(patches), points_(points), joints_(joints), rows_(rows),
      speeds_(speeds), tolerance_(tolerance), soon_(soon) {}

void Impacts::run(const std::function<double(const Patch&)>& rests, std::vector<char>& pushed) {
  list_patches();
  std::vector<double> speeds(patches_.size());
  const auto look = [&](std::size_t k) {
    const double speed = closing(patches_[k]);
    speeds[k] = speed > std::max(tolerance_, rests(patches_[k])) ? speed : 0;
  };
  for (std::size_t k = 0; k < patches_.size(); ++k) look(k);
  const std::size_t most = IMPACTS + IMPACTS_PER_PATCH * patches_.size();
  double least = 0;
  for (std::size_t i = 0; i < most; ++i) {
    const auto fastest = std::max_element(speeds.begin(), speeds.end());
    if (fastest == speeds.end() || *fastest == 0) return;
    if (i == 0) least = *fastest * LITTLE;
    if (*fastest < least && i >= IMPACTS) return;
    const Patch& first = patches_[static_cast<std::size_t>(fastest - speeds.begin())];
    const double speed = *fastest, together = speed * (1 - TOGETHER);
    bodies_.clear(), pulls_.clear();
    for (std::size_t k = 0; k < patches_.size(); ++k) {
      const Patch& patch = patches_[k];
      const bool same = patch.a == first.a && patch.b == first.b;
      if (same || speeds[k] >= together) gather(patch, rests(patch));
    }
    gather_joints();
    before_.clear();
    for (const std::size_t b : bodies_) before_.push_back(speeds_[b]), pushed[b] = 1;
    solve(speed);
    bound_energy();
    for (const std::size_t b : bodies_)
      for (std::size_t at = starts_[b]; at < starts_[b + 1]; ++at) look(listed_[at]);
  }
}

// Patches of each body.
void Impacts::list_patches() {
  const std::size_t count = world_.bodies.size();
  starts_.assign(count + 2, 0);
  for (const Patch& patch : patches_) {
    ++starts_[patch.a + 2];
    if (patch.b < count) ++starts_[patch.b + 2];
  }
  for (std::size_t i = 2; i < starts_.size(); ++i) starts_[i] += starts_[i - 1];
  listed_.resize(starts_.back());
  for (std::size_t k = 0; k < patches_.size(); ++k) {
    listed_[starts_[patches_[k].a + 1]++] = k;
    if (patches_[k].b < count) listed_[starts_[patches_[k].b + 1]++] = k;
  }
}

// Whether a point touches, or arrives at once.
bool Impacts::meets(const Patch& patch, const Point& p) const {
  if (p.now <= TOUCHING * world_.bodies[patch.a].reach) return true;
  return p.now <= -speed_along(speeds_, patch, p, 0) * soon_;
}

// Approach speed of a pair at its contact.
double Impacts::closing(const Patch& patch) const {
  double most = 0;
  for (std::size_t k = patch.begin; k < patch.end; ++k)
    if (meets(patch, points_[k]))
      most = std::max(most, -speed_along(speeds_, patch, points_[k], 0));
  return most;
}

// Equations of a pair: along the normal and, with friction, across it.
void Impacts::gather(const Patch& patch, double rest) {
  bodies_.push_back(patch.a);
  if (patch.b < world_.bodies.size()) bodies_.push_back(patch.b);
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    const Point& p = points_[k];
    if (!meets(patch, p)) continue;
    for (int d = 0; d < (patch.friction > 0 ? 3 : 1); ++d) {
      Pull pull;
      pull.a = patch.a, pull.b = patch.b;
      pull.line = d ? patch.tangents[d - 1] : patch.normal;
      pull.arm_a = p.arms_a[d], pull.arm_b = p.arms_b[d];
      pull.turn_a = p.turns_a[d], pull.turn_b = p.turns_b[d];
      pull.mass = d ? p.masses[d - 1] : p.mass;
      pull.given = d ? dot(pull.line, p.slide) : p.given;
      pull.across = d, pull.friction = patch.friction;
      pull.one_sided = d == 0;
      const double into = d ? 0.0 : -speed_of(pull);
      pull.target = into > rest ? patch.restitution * into : 0.0;
      pulls_.push_back(pull);
    }
  }
}

// Collects bodies connected by joints to those of an impact, transitively.
void Impacts::gather_joints() {
  const auto touched = [&](std::size_t i) {
    return std::find(bodies_.begin(), bodies_.end(), i) != bodies_.end();
  };
  std::vector<char> taken(joints_.size(), 0);
  for (bool more = !joints_.empty(); more;) {
    more = false;
    for (std::size_t k = 0; k < joints_.size(); ++k) {
      const Joint& joint = world_.joints[joints_[k]];
      const bool two = joint.a >= 0;
      const std::size_t a = two ? static_cast<std::size_t>(joint.a) : world_.bodies.size();
      if (taken[k] || !(touched(joint.b) || (two && touched(a)))) continue;
      taken[k] = 1, more = true;
      if (!touched(joint.b)) bodies_.push_back(joint.b);
      if (two && !touched(a)) bodies_.push_back(a);
      for (std::size_t r = 0; r < rows_[k].count; ++r) {
        const Row& row = rows_[k].of[r];
        if (row.kind == Row::DRIVE || (row.kind == Row::LIMIT && row.error > 0)) continue;
        Pull pull;
        pull.a = a, pull.b = joint.b, pull.line = row.line;
        pull.arm_a = row.arm_a, pull.arm_b = row.arm_b;
        pull.turn_a = speeds_[a].turned(row.arm_a), pull.turn_b = speeds_[joint.b].turned(row.arm_b);
        pull.mass = row.mass, pull.given = row.given;
        pull.one_sided = row.kind == Row::LIMIT, pull.joint = true;
        pulls_.push_back(pull);
      }
    }
  }
  std::sort(bodies_.begin(), bodies_.end());
  bodies_.erase(std::unique(bodies_.begin(), bodies_.end()), bodies_.end());
}

double Impacts::speed_of(const Pull& pull) const {
  const Speed &a = speeds_[pull.a], &b = speeds_[pull.b];
  return dot(pull.line, b.v - a.v) + dot(pull.arm_b, b.w) - dot(pull.arm_a, a.w) + pull.given;
}

void Impacts::add(Pull& pull, double impulse) {
  pull.impulse += impulse;
  apply(speeds_, pull.a, pull.b, pull.line, pull.turn_a, pull.turn_b, impulse);
}

void Impacts::solve(double speed) {
  const int joined = static_cast<int>(
      std::count_if(pulls_.begin(), pulls_.end(), [](const Pull& p) { return p.joint; }));
  const int most = ROUNDS_OF_ONE + ROUNDS_PER_JOINT * joined;
  for (int round = 0; round < most; ++round) {
    double change = 0;
    for (std::size_t k = 0; k < pulls_.size(); ++k) {
      Pull& pull = pulls_[k];
      if (pull.across == 0) {
        const double to = pull.impulse - pull.mass * (speed_of(pull) - pull.target);
        const double by = (pull.one_sided ? std::max(to, 0.0) : to) - pull.impulse;
        if (by == 0) continue;
        add(pull, by);
        change = std::max(change, std::fabs(by) / pull.mass);
      } else if (pull.across == 1) {
        Pull& other = pulls_[k + 1];
        const double limit = pull.friction * pulls_[k - 1].impulse;
        const double to[2] = {pull.impulse - pull.mass * speed_of(pull),
                              other.impulse - other.mass * speed_of(other)};
        const double size = std::sqrt(to[0] * to[0] + to[1] * to[1]);
        const double share = size > limit ? limit / size : 1;
        const double by[2] = {to[0] * share - pull.impulse, to[1] * share - other.impulse};
        if (by[0] != 0) add(pull, by[0]), change = std::max(change, std::fabs(by[0]) / pull.mass);
        if (by[1] != 0) add(other, by[1]), change = std::max(change, std::fabs(by[1]) / other.mass);
      }
    }
    if (change <= SOLVED * speed) return;
  }
}

// Scales an impact so that energy does not grow, except for what colliders and the animation add:
// along the impulses it is a parabola.
void Impacts::bound_energy() {
  double slope = 0, size = 0, whole = 0;
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    const Body& body = world_.bodies[bodies_[i]];
    const Speed &old = before_[i], &now = speeds_[bodies_[i]];
    const Vec way = now.v - old.v;
    slope += dot(old.v, way) / body.ease, size += dot(way, way) / body.ease / 2;
    whole += dot(old.v, old.v) / body.ease / 2;
  }
  // Rotational work from the impulses themselves: w I dw is w times the twist.
  for (const Pull& pull : pulls_) {
    const auto at = [&](std::size_t body) {
      return std::lower_bound(bodies_.begin(), bodies_.end(), body) - bodies_.begin();
    };
    double spin = 0, turned = 0;
    if (pull.a < world_.bodies.size()) {
      const Speed &old = before_[static_cast<std::size_t>(at(pull.a))], &now = speeds_[pull.a];
      spin -= dot(pull.arm_a, old.w), turned -= dot(pull.arm_a, now.w - old.w);
    }
    if (pull.b < world_.bodies.size()) {
      const Speed &old = before_[static_cast<std::size_t>(at(pull.b))], &now = speeds_[pull.b];
      spin += dot(pull.arm_b, old.w), turned += dot(pull.arm_b, now.w - old.w);
    }
    slope += pull.impulse * (spin + pull.given), size += pull.impulse * turned / 2;
  }
  if (!(slope + size > EXACT * (whole + size)) || !(size > 0)) return;
  const double share = std::clamp(-slope / size, 0.0, 1.0);
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    Speed& now = speeds_[bodies_[i]];
    now.v = before_[i].v + (now.v - before_[i].v) * share;
    now.w = before_[i].w + (now.w - before_[i].w) * share;
  }
}

}  // namespace animtool::rigid
