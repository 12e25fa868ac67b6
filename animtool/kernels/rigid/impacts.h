// Impacts: contacts that are fast enough to bounce. The points of a pair are solved together from
// the velocities before, with the joints of both bodies (Newton's law of restitution, Coulomb's
// friction). Pairs that approach as a result are solved next, with their new velocities, until none
// approaches (sequential impacts, as in Newton's cradle); equally fast pairs are solved together.
// If friction would add kinetic energy, the impulses are scaled down.
#pragma once

#include <functional>
#include <vector>

#include "rigid/points.h"

namespace animtool::rigid {

// Distance below which points are in contact, over the size of the body.
constexpr double TOUCH_DISTANCE = 1e-4;

// Solves the impacts of an island.
class ImpactSolver {
 public:
  // The island is given by its patches and points, and the rows of its joints. Approaches slower
  // than a tolerance [m/s] are ignored; arrivals within a time [s] count as contact.
  ImpactSolver(const World& world, const std::vector<Patch>& patches,
               const std::vector<Point>& points, const std::vector<std::size_t>& joints,
               const std::vector<Rows>& rows, std::vector<Speed>& speeds, double tolerance,
               double max_arrival_time);

  // Changes velocities, and marks the bodies that were pushed. Patches slower than `rest_speed` do
  // not bounce.
  void run(const std::function<double(const Patch&)>& rest_speed, std::vector<char>& is_pushed);

 private:
  struct Equation {  // one equation of an impact
    std::size_t a, b;
    Vec line, arm_a, arm_b, response_a, response_b;
    double mass, bias_speed;
    double target_speed = 0;  // speed after the impact
    double impulse = 0;
    bool is_one_sided = false, is_joint = false;
    int tangent = 0;  // 1 or 2 for friction, 0 for the normal; the normal equation precedes both
    double friction = 0;
  };

  void list_patches();
  double approach_speed(const Patch& patch) const;
  bool is_touching(const Patch& patch, const Point& p) const;
  void add_patch_equations(const Patch& patch, double rest_speed);
  void add_joint_equations();
  void solve(double speed);
  void bound_energy();
  double speed_of(const Equation& equation) const;
  void add_impulse(Equation& equation, double impulse);

  const World& world_;
  const std::vector<Patch>& patches_;
  const std::vector<Point>& points_;
  const std::vector<std::size_t>& joints_;
  const std::vector<Rows>& rows_;
  std::vector<Speed>& speeds_;
  double tolerance_, max_arrival_time_;
  std::vector<std::size_t> patch_starts_,
      patches_by_body_;  // patches of each body, and their starts
  std::vector<Equation> equations_;
  std::vector<std::size_t> bodies_;  // of an impact, ascending
  std::vector<Speed> old_speeds_;    // velocities of these bodies before the impact
};

}  // namespace animtool::rigid
