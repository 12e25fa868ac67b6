#include "rigid/impacts.h"

#include <algorithm>
#include <cmath>

namespace animtool::rigid {

namespace {

// Pairs whose approach speed is within this fraction of the fastest are solved together.
constexpr double SAME_SPEED_TOLERANCE = 1e-3;
// An impact has converged if velocities change by less than this fraction of the fastest approach.
constexpr double CONVERGENCE_FRACTION = 1e-7;
// Largest number of iterations of an impact.
constexpr int BASE_ITERATIONS = 40, ITERATIONS_PER_JOINT = 8;
// Largest number of impacts in a substep, in a chain of bodies; later ones are inelastic.
constexpr std::size_t BASE_IMPACTS = 16, IMPACTS_PER_PATCH = 4;
// After BASE_IMPACTS impacts, approaches below this fraction of the fastest are ignored.
constexpr double NEGLIGIBLE_SPEED = 0.05;
// Relative rounding error of a sum of energies.
constexpr double ENERGY_ROUNDING = 1e-13;

}  // namespace

ImpactSolver::ImpactSolver(const World& world, const std::vector<Patch>& patches,
                           const std::vector<Point>& points, const std::vector<std::size_t>& joints,
                           const std::vector<Rows>& rows, std::vector<Speed>& speeds,
                           double tolerance, double max_arrival_time)
    : world_(world),
      patches_(patches),
      points_(points),
      joints_(joints),
      rows_(rows),
      speeds_(speeds),
      tolerance_(tolerance),
      max_arrival_time_(max_arrival_time) {}

void ImpactSolver::run(const std::function<double(const Patch&)>& rest_speed,
                       std::vector<char>& is_pushed) {
  list_patches();
  std::vector<double> speeds(patches_.size());
  const auto update_speed = [&](std::size_t k) {
    const double speed = approach_speed(patches_[k]);
    speeds[k] = speed > std::max(tolerance_, rest_speed(patches_[k])) ? speed : 0;
  };
  for (std::size_t k = 0; k < patches_.size(); ++k) update_speed(k);
  const std::size_t max_impacts = BASE_IMPACTS + IMPACTS_PER_PATCH * patches_.size();
  double min_speed = 0;
  for (std::size_t impact = 0; impact < max_impacts; ++impact) {
    const auto fastest_speed = std::max_element(speeds.begin(), speeds.end());
    if (fastest_speed == speeds.end() || *fastest_speed == 0) return;
    if (impact == 0) min_speed = *fastest_speed * NEGLIGIBLE_SPEED;
    if (*fastest_speed < min_speed && impact >= BASE_IMPACTS) return;
    const Patch& fastest_patch = patches_[static_cast<std::size_t>(fastest_speed - speeds.begin())];
    const double speed = *fastest_speed, min_combined_speed = speed * (1 - SAME_SPEED_TOLERANCE);
    bodies_.clear(), equations_.clear();
    for (std::size_t k = 0; k < patches_.size(); ++k) {
      const Patch& patch = patches_[k];
      const bool is_same_pair = patch.a == fastest_patch.a && patch.b == fastest_patch.b;
      if (is_same_pair || speeds[k] >= min_combined_speed)
        add_patch_equations(patch, rest_speed(patch));
    }
    add_joint_equations();
    old_speeds_.clear();
    for (const std::size_t b : bodies_) old_speeds_.push_back(speeds_[b]), is_pushed[b] = 1;
    solve(speed);
    bound_energy();
    for (const std::size_t b : bodies_)
      for (std::size_t i = patch_starts_[b]; i < patch_starts_[b + 1]; ++i)
        update_speed(patches_by_body_[i]);
  }
}

// Lists the patches of each body.
void ImpactSolver::list_patches() {
  const std::size_t count = world_.bodies.size();
  patch_starts_.assign(count + 2, 0);
  for (const Patch& patch : patches_) {
    ++patch_starts_[patch.a + 2];
    if (patch.b < count) ++patch_starts_[patch.b + 2];
  }
  for (std::size_t i = 2; i < patch_starts_.size(); ++i) patch_starts_[i] += patch_starts_[i - 1];
  patches_by_body_.resize(patch_starts_.back());
  for (std::size_t k = 0; k < patches_.size(); ++k) {
    patches_by_body_[patch_starts_[patches_[k].a + 1]++] = k;
    if (patches_[k].b < count) patches_by_body_[patch_starts_[patches_[k].b + 1]++] = k;
  }
}

// Whether a point is in contact, or arrives immediately.
bool ImpactSolver::is_touching(const Patch& patch, const Point& p) const {
  if (p.current_gap <= TOUCH_DISTANCE * world_.bodies[patch.a].bounding_radius) return true;
  return p.current_gap <= -speed_along(speeds_, patch, p, 0) * max_arrival_time_;
}

// Approach speed of a pair of bodies at a patch.
double ImpactSolver::approach_speed(const Patch& patch) const {
  double max_speed = 0;
  for (std::size_t k = patch.begin; k < patch.end; ++k)
    if (is_touching(patch, points_[k]))
      max_speed = std::max(max_speed, -speed_along(speeds_, patch, points_[k], 0));
  return max_speed;
}

// Adds the equations of a patch: along the normal and, with friction, along the tangents.
void ImpactSolver::add_patch_equations(const Patch& patch, double rest_speed) {
  bodies_.push_back(patch.a);
  if (patch.b < world_.bodies.size()) bodies_.push_back(patch.b);
  for (std::size_t k = patch.begin; k < patch.end; ++k) {
    const Point& p = points_[k];
    if (!is_touching(patch, p)) continue;
    for (int d = 0; d < (patch.friction > 0 ? 3 : 1); ++d) {
      Equation equation;
      equation.a = patch.a, equation.b = patch.b;
      equation.line = d ? patch.tangents[d - 1] : patch.normal;
      equation.arm_a = p.arms_a[d], equation.arm_b = p.arms_b[d];
      equation.response_a = p.responses_a[d], equation.response_b = p.responses_b[d];
      equation.mass = d ? p.tangent_masses[d - 1] : p.mass;
      equation.bias_speed = d ? dot(equation.line, p.slide_velocity) : p.bias_speed;
      equation.tangent = d, equation.friction = patch.friction;
      equation.is_one_sided = d == 0;
      const double approach = d ? 0.0 : -speed_of(equation);
      equation.target_speed = approach > rest_speed ? patch.restitution * approach : 0.0;
      equations_.push_back(equation);
    }
  }
}

// Adds the joints and bodies that are connected to those of an impact.
void ImpactSolver::add_joint_equations() {
  const auto is_body_included = [&](std::size_t i) {
    return std::find(bodies_.begin(), bodies_.end(), i) != bodies_.end();
  };
  std::vector<char> is_joint_included(joints_.size(), 0);
  for (bool has_added = !joints_.empty(); has_added;) {
    has_added = false;
    for (std::size_t k = 0; k < joints_.size(); ++k) {
      const Joint& joint = world_.joints[joints_[k]];
      const bool has_first_body = joint.a >= 0;
      const std::size_t a =
          has_first_body ? static_cast<std::size_t>(joint.a) : world_.bodies.size();
      if (is_joint_included[k] ||
          !(is_body_included(joint.b) || (has_first_body && is_body_included(a))))
        continue;
      is_joint_included[k] = 1, has_added = true;
      if (!is_body_included(joint.b)) bodies_.push_back(joint.b);
      if (has_first_body && !is_body_included(a)) bodies_.push_back(a);
      for (std::size_t r = 0; r < rows_[k].count; ++r) {
        const Row& row = rows_[k].entries[r];
        if (row.kind == Row::DRIVE || (row.kind == Row::LIMIT && row.error > 0)) continue;
        Equation equation;
        equation.a = a, equation.b = joint.b, equation.line = row.line;
        equation.arm_a = row.arm_a, equation.arm_b = row.arm_b;
        equation.response_a = speeds_[a].angular_response(row.arm_a),
        equation.response_b = speeds_[joint.b].angular_response(row.arm_b);
        equation.mass = row.mass, equation.bias_speed = row.bias_speed;
        equation.is_one_sided = row.kind == Row::LIMIT, equation.is_joint = true;
        equations_.push_back(equation);
      }
    }
  }
  std::sort(bodies_.begin(), bodies_.end());
  bodies_.erase(std::unique(bodies_.begin(), bodies_.end()), bodies_.end());
}

double ImpactSolver::speed_of(const Equation& equation) const {
  const Speed &a = speeds_[equation.a], &b = speeds_[equation.b];
  return dot(equation.line, b.v - a.v) + dot(equation.arm_b, b.w) - dot(equation.arm_a, a.w) +
         equation.bias_speed;
}

void ImpactSolver::add_impulse(Equation& equation, double impulse) {
  equation.impulse += impulse;
  apply(speeds_, equation.a, equation.b, equation.line, equation.response_a, equation.response_b,
        impulse);
}

void ImpactSolver::solve(double speed) {
  const int joint_equation_count = static_cast<int>(std::count_if(
      equations_.begin(), equations_.end(), [](const Equation& p) { return p.is_joint; }));
  const int max_iterations = BASE_ITERATIONS + ITERATIONS_PER_JOINT * joint_equation_count;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    double max_change = 0;
    for (std::size_t k = 0; k < equations_.size(); ++k) {
      Equation& equation = equations_[k];
      if (equation.tangent == 0) {
        const double target_impulse =
            equation.impulse - equation.mass * (speed_of(equation) - equation.target_speed);
        const double impulse_change =
            (equation.is_one_sided ? std::max(target_impulse, 0.0) : target_impulse) -
            equation.impulse;
        if (impulse_change == 0) continue;
        add_impulse(equation, impulse_change);
        max_change = std::max(max_change, std::fabs(impulse_change) / equation.mass);
      } else if (equation.tangent == 1) {
        Equation& other = equations_[k + 1];
        const double limit = equation.friction * equations_[k - 1].impulse;
        const double target_impulse[2] = {equation.impulse - equation.mass * speed_of(equation),
                                          other.impulse - other.mass * speed_of(other)};
        const double magnitude = std::sqrt(target_impulse[0] * target_impulse[0] +
                                           target_impulse[1] * target_impulse[1]);
        const double scale = magnitude > limit ? limit / magnitude : 1;
        const double impulse_change[2] = {target_impulse[0] * scale - equation.impulse,
                                          target_impulse[1] * scale - other.impulse};
        if (impulse_change[0] != 0)
          add_impulse(equation, impulse_change[0]),
              max_change = std::max(max_change, std::fabs(impulse_change[0]) / equation.mass);
        if (impulse_change[1] != 0)
          add_impulse(other, impulse_change[1]),
              max_change = std::max(max_change, std::fabs(impulse_change[1]) / other.mass);
      }
    }
    if (max_change <= CONVERGENCE_FRACTION * speed) return;
  }
}

// Scales an impact so that energy does not grow, except for what colliders and animation add: along
// the impulses, energy is a parabola.
void ImpactSolver::bound_energy() {
  double slope = 0, quadratic = 0, energy = 0;
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    const Body& body = world_.bodies[bodies_[i]];
    const Speed &old_speed = old_speeds_[i], &new_speed = speeds_[bodies_[i]];
    const Vec velocity_change = new_speed.v - old_speed.v;
    slope += dot(old_speed.v, velocity_change) / body.inverse_mass,
        quadratic += dot(velocity_change, velocity_change) / body.inverse_mass / 2;
    energy += dot(old_speed.v, old_speed.v) / body.inverse_mass / 2;
  }
  // Rotational work of the impulses themselves: w I dw is w times the angular impulse.
  for (const Equation& equation : equations_) {
    const auto body_index = [&](std::size_t body) {
      return std::lower_bound(bodies_.begin(), bodies_.end(), body) - bodies_.begin();
    };
    double angular_work = 0, angular_change = 0;
    if (equation.a < world_.bodies.size()) {
      const Speed &old_speed = old_speeds_[static_cast<std::size_t>(body_index(equation.a))],
                  &new_speed = speeds_[equation.a];
      angular_work -= dot(equation.arm_a, old_speed.w),
          angular_change -= dot(equation.arm_a, new_speed.w - old_speed.w);
    }
    if (equation.b < world_.bodies.size()) {
      const Speed &old_speed = old_speeds_[static_cast<std::size_t>(body_index(equation.b))],
                  &new_speed = speeds_[equation.b];
      angular_work += dot(equation.arm_b, old_speed.w),
          angular_change += dot(equation.arm_b, new_speed.w - old_speed.w);
    }
    slope += equation.impulse * (angular_work + equation.bias_speed),
        quadratic += equation.impulse * angular_change / 2;
  }
  if (!(slope + quadratic > ENERGY_ROUNDING * (energy + quadratic)) || !(quadratic > 0)) return;
  const double scale = std::clamp(-slope / quadratic, 0.0, 1.0);
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    Speed& new_speed = speeds_[bodies_[i]];
    new_speed.v = old_speeds_[i].v + (new_speed.v - old_speeds_[i].v) * scale;
    new_speed.w = old_speeds_[i].w + (new_speed.w - old_speeds_[i].w) * scale;
  }
}

}  // namespace animtool::rigid
