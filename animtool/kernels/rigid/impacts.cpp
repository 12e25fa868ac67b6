#include "rigid/impacts.h"

#include <algorithm>
#include <cmath>

namespace animtool::rigid {

namespace {

// Pairs approaching within this fraction of the fastest are solved together.
constexpr double EQUALLY_FAST = 1e-3;
// An impact is converged if velocities change by less than this fraction of the fastest approach.
constexpr double CONVERGED = 1e-7;
constexpr int MIN_ITERATIONS = 40, ITERATIONS_PER_JOINT = 8;
// Largest number of impacts in a substep, in a chain of bodies; the rest is inelastic.
constexpr std::size_t IMPACTS = 16, IMPACTS_PER_PATCH = 4;
// After the first impact, approaches below this fraction of the fastest are ignored too.
constexpr double NEGLIGIBLE = 0.05;
// Rounding of a sum of energies.
constexpr double ENERGY_ROUNDING = 1e-13;

}  // namespace

Impacts::Impacts(const World& world, const std::vector<Patch>& patches,
                 const std::vector<Point>& points, const std::vector<std::size_t>& joints,
                 const std::vector<Rows>& rows, std::vector<Speed>& speeds, double tolerance,
                 double arrival_time)
    : world_(world),
      patches_(patches),
      points_(points),
      joints_(joints),
      rows_(rows),
      speeds_(speeds),
      tolerance_(tolerance),
      arrival_time_(arrival_time) {}

void Impacts::run(const std::function<double(const Patch&)>& rests, std::vector<char>& pushed) {
  list_patches();
  std::vector<double> speeds(patches_.size());
  const auto update_speed = [&](std::size_t k) {
    const double speed = approach_speed(patches_[k]);
    speeds[k] = speed > std::max(tolerance_, rests(patches_[k])) ? speed : 0;
  };
  for (std::size_t k = 0; k < patches_.size(); ++k) update_speed(k);
  const std::size_t max_impacts = IMPACTS + IMPACTS_PER_PATCH * patches_.size();
  double least = 0;
  for (std::size_t i = 0; i < max_impacts; ++i) {
    const auto fastest = std::max_element(speeds.begin(), speeds.end());
    if (fastest == speeds.end() || *fastest == 0) return;
    if (i == 0) least = *fastest * NEGLIGIBLE;
    if (*fastest < least && i >= IMPACTS) return;
    const Patch& first = patches_[static_cast<std::size_t>(fastest - speeds.begin())];
    const double speed = *fastest, combined_speed = speed * (1 - EQUALLY_FAST);
    bodies_.clear(), equations_.clear();
    for (std::size_t k = 0; k < patches_.size(); ++k) {
      const Patch& patch = patches_[k];
      const bool same = patch.a == first.a && patch.b == first.b;
      if (same || speeds[k] >= combined_speed) gather(patch, rests(patch));
    }
    gather_joints();
    before_.clear();
    for (const std::size_t b : bodies_) before_.push_back(speeds_[b]), pushed[b] = 1;
    solve(speed);
    bound_energy();
    for (const std::size_t b : bodies_)
      for (std::size_t at = starts_[b]; at < starts_[b + 1]; ++at) update_speed(listed_[at]);
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
bool Impacts::touches(const Patch& patch, const Point& p) const {
  if (p.current_gap <= TOUCHING * world_.bodies[patch.a].reach) return true;
  return p.current_gap <= -speed_along(speeds_, patch, p, 0) * arrival_time_;
}

// Approach speed of a pair at its contact.
double Impacts::approach_speed(const Patch& patch) const {
  double most = 0;
  for (std::size_t k = patch.begin; k < patch.end; ++k)
    if (touches(patch, points_[k]))
      most = std::max(most, -speed_along(speeds_, patch, points_[k], 0));
  return most;
}

// Equations of a pair: along the normal and, with friction, across it.
void Impacts::gather(const Patch& patch, double rest) {
  bodies_.push_back(patch.a);
  if (patch.b < world_.bodies.size()) bodies_.push_back(patch.b);
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    const Point& p = points_[k];
    if (!touches(patch, p)) continue;
    for (int d = 0; d < (patch.friction > 0 ? 3 : 1); ++d) {
      Equation equation;
      equation.a = patch.a, equation.b = patch.b;
      equation.line = d ? patch.tangents[d - 1] : patch.normal;
      equation.arm_a = p.arms_a[d], equation.arm_b = p.arms_b[d];
      equation.response_a = p.responses_a[d], equation.response_b = p.responses_b[d];
      equation.mass = d ? p.masses[d - 1] : p.mass;
      equation.bias_speed = d ? dot(equation.line, p.slide) : p.bias_speed;
      equation.across = d, equation.friction = patch.friction;
      equation.one_sided = d == 0;
      const double into = d ? 0.0 : -speed_of(equation);
      equation.target = into > rest ? patch.restitution * into : 0.0;
      equations_.push_back(equation);
    }
  }
}

// Collects bodies connected by joints to those of an impact, transitively.
void Impacts::gather_joints() {
  const auto is_included = [&](std::size_t i) {
    return std::find(bodies_.begin(), bodies_.end(), i) != bodies_.end();
  };
  std::vector<char> included(joints_.size(), 0);
  for (bool more = !joints_.empty(); more;) {
    more = false;
    for (std::size_t k = 0; k < joints_.size(); ++k) {
      const Joint& joint = world_.joints[joints_[k]];
      const bool two = joint.a >= 0;
      const std::size_t a = two ? static_cast<std::size_t>(joint.a) : world_.bodies.size();
      if (included[k] || !(is_included(joint.b) || (two && is_included(a)))) continue;
      included[k] = 1, more = true;
      if (!is_included(joint.b)) bodies_.push_back(joint.b);
      if (two && !is_included(a)) bodies_.push_back(a);
      for (std::size_t r = 0; r < rows_[k].count; ++r) {
        const Row& row = rows_[k].of[r];
        if (row.kind == Row::DRIVE || (row.kind == Row::LIMIT && row.error > 0)) continue;
        Equation equation;
        equation.a = a, equation.b = joint.b, equation.line = row.line;
        equation.arm_a = row.arm_a, equation.arm_b = row.arm_b;
        equation.response_a = speeds_[a].angular_response(row.arm_a),
        equation.response_b = speeds_[joint.b].angular_response(row.arm_b);
        equation.mass = row.mass, equation.bias_speed = row.bias_speed;
        equation.one_sided = row.kind == Row::LIMIT, equation.joint = true;
        equations_.push_back(equation);
      }
    }
  }
  std::sort(bodies_.begin(), bodies_.end());
  bodies_.erase(std::unique(bodies_.begin(), bodies_.end()), bodies_.end());
}

double Impacts::speed_of(const Equation& equation) const {
  const Speed &a = speeds_[equation.a], &b = speeds_[equation.b];
  return dot(equation.line, b.v - a.v) + dot(equation.arm_b, b.w) - dot(equation.arm_a, a.w) +
         equation.bias_speed;
}

void Impacts::add(Equation& equation, double impulse) {
  equation.impulse += impulse;
  apply(speeds_, equation.a, equation.b, equation.line, equation.response_a, equation.response_b,
        impulse);
}

void Impacts::solve(double speed) {
  const int joined = static_cast<int>(std::count_if(equations_.begin(), equations_.end(),
                                                    [](const Equation& p) { return p.joint; }));
  const int max_iterations = MIN_ITERATIONS + ITERATIONS_PER_JOINT * joined;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    double change = 0;
    for (std::size_t k = 0; k < equations_.size(); ++k) {
      Equation& equation = equations_[k];
      if (equation.across == 0) {
        const double to = equation.impulse - equation.mass * (speed_of(equation) - equation.target);
        const double by = (equation.one_sided ? std::max(to, 0.0) : to) - equation.impulse;
        if (by == 0) continue;
        add(equation, by);
        change = std::max(change, std::fabs(by) / equation.mass);
      } else if (equation.across == 1) {
        Equation& other = equations_[k + 1];
        const double limit = equation.friction * equations_[k - 1].impulse;
        const double to[2] = {equation.impulse - equation.mass * speed_of(equation),
                              other.impulse - other.mass * speed_of(other)};
        const double size = std::sqrt(to[0] * to[0] + to[1] * to[1]);
        const double scale = size > limit ? limit / size : 1;
        const double by[2] = {to[0] * scale - equation.impulse, to[1] * scale - other.impulse};
        if (by[0] != 0)
          add(equation, by[0]), change = std::max(change, std::fabs(by[0]) / equation.mass);
        if (by[1] != 0) add(other, by[1]), change = std::max(change, std::fabs(by[1]) / other.mass);
      }
    }
    if (change <= CONVERGED * speed) return;
  }
}

// Scales an impact so that energy does not grow, except for what colliders and the animation add:
// along the impulses it is a parabola.
void Impacts::bound_energy() {
  double slope = 0, size = 0, energy = 0;
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    const Body& body = world_.bodies[bodies_[i]];
    const Speed &old = before_[i], &now = speeds_[bodies_[i]];
    const Vec change = now.v - old.v;
    slope += dot(old.v, change) / body.inverse_mass,
        size += dot(change, change) / body.inverse_mass / 2;
    energy += dot(old.v, old.v) / body.inverse_mass / 2;
  }
  // Rotational work from the impulses themselves: w I dw is w times the twist.
  for (const Equation& equation : equations_) {
    const auto at = [&](std::size_t body) {
      return std::lower_bound(bodies_.begin(), bodies_.end(), body) - bodies_.begin();
    };
    double spin = 0, turned = 0;
    if (equation.a < world_.bodies.size()) {
      const Speed &old = before_[static_cast<std::size_t>(at(equation.a))],
                  &now = speeds_[equation.a];
      spin -= dot(equation.arm_a, old.w), turned -= dot(equation.arm_a, now.w - old.w);
    }
    if (equation.b < world_.bodies.size()) {
      const Speed &old = before_[static_cast<std::size_t>(at(equation.b))],
                  &now = speeds_[equation.b];
      spin += dot(equation.arm_b, old.w), turned += dot(equation.arm_b, now.w - old.w);
    }
    slope += equation.impulse * (spin + equation.bias_speed), size += equation.impulse * turned / 2;
  }
  if (!(slope + size > ENERGY_ROUNDING * (energy + size)) || !(size > 0)) return;
  const double scale = std::clamp(-slope / size, 0.0, 1.0);
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    Speed& now = speeds_[bodies_[i]];
    now.v = before_[i].v + (now.v - before_[i].v) * scale;
    now.w = before_[i].w + (now.w - before_[i].w) * scale;
  }
}

}  // namespace animtool::rigid
