// Closed form of six-pin arms with a spherical wrist or three parallel axes.
//
// Angles are found one after the other by geometric subproblems: the rotation that takes one
// vector to another (1), two such rotations (2), and a rotation after which a vector has a given
// component along another (4) or a given distance from it (3) (B. Paden, Kinematics and control
// of robot manipulators, 1986; A. Elias, J. Wen, IK-Geo, 2022). Everything is in the frame of
// the pose with zero angles, where axis i is the line through `at` along `axes`. Newton's method
// removes errors of rounding, and of axes in files that intersect only approximately.
//
// Limits of the method: if axes intersect or are parallel only approximately, a branch next to a
// singular pose may be missed. If axes are collinear, or the wrist lies on the first axis, there
// are infinitely many solutions: the free angle is that of the start.
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "ik/closed.h"
#include "ik/limits.h"
#include "ik/linear.h"

namespace animtool::ik {

namespace {

// How far axes may be from intersecting, as a fraction of the length, or from parallel [rad].
constexpr double ARM_NEARLY = 1e-3;
// Vectors shorter than this have no direction.
constexpr double ARM_OPEN = 1e-10;
// Tolerance of Newton's method, and its largest number of steps.
constexpr double ARM_EXACT = 1e-15;
constexpr int ARM_STEPS = 8;
// Pivots below this fraction of the first count as zero.
constexpr double ARM_PIVOT = 1e-11;

using Triple = std::array<double, 3>;

Triple minus(const Triple& a, const Triple& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

Triple plus(const Triple& a, const Triple& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }

Triple times(double scale, const Triple& a) { return {scale * a[0], scale * a[1], scale * a[2]}; }

double inner(const Triple& a, const Triple& b) { return dot(a.data(), b.data()); }

Triple crossed(const Triple& a, const Triple& b) {
  Triple c;
  cross(a.data(), b.data(), c.data());
  return c;
}

double size(const Triple& a) { return length(a.data()); }

// A rotation about a unit axis.
Triple turned(const Triple& axis, double angle, const Triple& v) {
  const double c = std::cos(angle), s = std::sin(angle), along = (1 - c) * inner(axis, v);
  const Triple side = crossed(axis, v);
  Triple out;
  for (int i = 0; i < 3; ++i) out[i] = c * v[i] + s * side[i] + along * axis[i];
  return out;
}

// Solutions of an equation: none, one or two angles, or `open` if all.
struct Angles {
  int count = 0;
  double values[2] = {};
};

// Subproblem 1: the rotation from p to q; `open` if they lie on the axis.
double angle_between(const Triple& axis, const Triple& p, const Triple& q, double open) {
  const Triple side = crossed(axis, p), other = crossed(axis, q);
  if (std::min(size(side), size(other)) < ARM_OPEN) return open;
  return std::atan2(inner(axis, crossed(side, other)), inner(side, other));
}

// Subproblem 4: rotations of p about an axis after which its component along h is d. A d that is
// out of range by up to `slack` is clamped.
Angles angles_along(const Triple& axis, const Triple& p, const Triple& h, double d, double slack,
                    double open) {
  const double along = inner(h, axis) * inner(axis, p);
  const double even = inner(h, p) - along, sine_part = inner(h, crossed(axis, p)), rest = d - along;
  const double most = std::hypot(even, sine_part);
  if (most < ARM_OPEN) return std::fabs(rest) < ARM_OPEN + slack ? Angles{1, {open}} : Angles{};
  const double cosine = rest / most;
  if (std::fabs(cosine) > 1 + slack / most) return {};
  const double middle = std::atan2(sine_part, even), clamped = std::clamp(cosine, -1.0, 1.0);
  const double away = std::atan2(std::sqrt((1 - clamped) * (1 + clamped)), clamped);
  return {2, {middle + away, middle - away}};
}

// Subproblem 3: rotations of p about an axis after which it has a given distance from q.
Angles angles_at_distance(const Triple& axis, const Triple& p, const Triple& q, double distance,
                          double slack, double open) {
  return angles_along(axis, p, q, (inner(p, p) + inner(q, q) - distance * distance) / 2, slack,
                      open);
}

// Subproblem 2: rotations of p and q about two axes that take them to the same vector.
template <class Use>
void angles_to_common(const Triple& first, const Triple& p, const Triple& second, const Triple& q,
                      double slack, double open_first, double open_second, Use&& use) {
  const double mixed = inner(first, second), sine = 1 - mixed * mixed;
  const double along = inner(first, p), other = inner(second, q);
  const double a = (along - mixed * other) / sine, b = (other - mixed * along) / sine;
  const Triple normal = crossed(first, second);
  const Triple flat = plus(times(a, first), times(b, second));
  const double left = inner(p, p) - inner(flat, flat);
  if (left < -slack) return;
  const double height = std::sqrt(std::max(left, 0.0) / sine);
  for (const double sign : {1.0, -1.0}) {
    const Triple crossing = plus(flat, times(sign * height, normal));
    use(angle_between(first, p, crossing, open_first),
        angle_between(second, q, crossing, open_second));
  }
}

// The line of an axis, and the relation of two lines.
struct Line {
  Triple axis, at;
};

double out_of_parallel(const Line& a, const Line& b) { return size(crossed(a.axis, b.axis)); }

// The point of line a nearest to line b, and their distance.
double crossing(const Line& a, const Line& b, Triple& point) {
  const Triple between = minus(b.at, a.at);
  const double mixed = inner(a.axis, b.axis), sine = 1 - mixed * mixed;
  if (sine < ARM_NEARLY) return HUGE_VAL;
  const double along = (inner(between, a.axis) - mixed * inner(between, b.axis)) / sine;
  point = plus(a.at, times(along, a.axis));
  const Triple away = minus(point, b.at);
  return size(minus(away, times(inner(away, b.axis), b.axis)));
}

bool on_line(const Triple& point, const Line& line) {
  const Triple away = minus(point, line.at);
  return size(minus(away, times(inner(away, line.axis), line.axis))) < ARM_NEARLY;
}

// Methods that place the wrist with the first three axes.
enum class Approach { NONE, LATER_PARALLEL, LATER_MEET, EARLIER_MEET, EARLIER_PARALLEL };

// Geometry of an arm at zero angles.
struct Anatomy {
  ArmKind kind = ArmKind::NONE;
  Approach reach = Approach::NONE;
  Line lines[ARM_PINS];
  Triple wrist;  // intersection of the last three axes, or of the last two
  Triple joint;  // intersection of two of the first three axes
  Triple tip;
  double unrotated[9];  // the rotation of the last node
};

bool is_arm(const Task& task) {
  if (task.chain.nodes.size() != ARM_PINS || task.goals.size() != 1) return false;
  for (std::size_t n = 0; n < ARM_PINS; ++n) {
    const Node& node = task.chain.nodes[n];
    const bool plain = node.gain == 1 && node.shift == 0 && !node.follows && node.program < 0;
    if (node.kind != Kind::PIN || node.parent != static_cast<int>(n) - 1 || !plain) return false;
  }
  const Goal& goal = task.goals[0];
  constexpr int position = part_of<Position>(), orientation = part_of<Orientation>();
  for (int part = 0; part < PARTS; ++part)
    if ((goal.weights[part] > 0) != (part == position || part == orientation)) return false;
  return goal.node == static_cast<int>(ARM_PINS) - 1 && !(task.rest_weight > 0);
}

Approach approach_of(Anatomy& arm) {
  const Line* lines = arm.lines;
  if (out_of_parallel(lines[0], lines[1]) > ARM_NEARLY) {
    if (out_of_parallel(lines[1], lines[2]) < ARM_NEARLY) return Approach::LATER_PARALLEL;
    if (crossing(lines[0], lines[1], arm.joint) < ARM_NEARLY) return Approach::EARLIER_MEET;
  } else if (out_of_parallel(lines[1], lines[2]) > ARM_NEARLY) {
    return Approach::EARLIER_PARALLEL;
  }
  return crossing(lines[1], lines[2], arm.joint) < ARM_NEARLY ? Approach::LATER_MEET
                                                              : Approach::NONE;
}

Anatomy look(const Task& task) {
  Anatomy arm;
  if (!is_arm(task)) return arm;
  Frames frames(task.chain);
  const double zero[ARM_PINS] = {};
  forward(task.chain, zero, frames);
  for (std::size_t n = 0; n < ARM_PINS; ++n) {
    std::copy_n(&frames.axes[9 * n], 3, arm.lines[n].axis.data());
    std::copy_n(&frames.origins[3 * n], 3, arm.lines[n].at.data());
  }
  std::copy_n(&frames.rotations[9 * (ARM_PINS - 1)], 9, arm.unrotated);
  rotate(arm.unrotated, task.goals[0].offset, arm.tip.data());
  arm.tip = plus(arm.tip, arm.lines[ARM_PINS - 1].at);
  if (!(crossing(arm.lines[4], arm.lines[5], arm.wrist) < ARM_NEARLY)) return arm;
  const Line* lines = arm.lines;
  if (out_of_parallel(lines[1], lines[2]) < ARM_NEARLY &&
      out_of_parallel(lines[2], lines[3]) < ARM_NEARLY &&
      out_of_parallel(lines[0], lines[1]) > ARM_NEARLY &&
      out_of_parallel(lines[3], lines[4]) > ARM_NEARLY) {
    arm.kind = ArmKind::PARALLEL;
    return arm;
  }
  const bool wrist =
      on_line(arm.wrist, lines[3]) && out_of_parallel(lines[3], lines[4]) > ARM_NEARLY;
  arm.reach = wrist ? approach_of(arm) : Approach::NONE;
  if (arm.reach != Approach::NONE) arm.kind = ArmKind::WRIST;
  return arm;
}

class SixPins : public Arm {
 public:
  SixPins(const Task& task, const Anatomy& arm, double length_tolerance, double angle_tolerance)
      : task_(task),
        arm_(arm),
        tolerances_{length_tolerance, angle_tolerance},
        state_(task),
        linear_(task) {}

  bool follows() const override { return true; }

  bool solve(const double* start, const double* target, const double*, double, double* q,
             double* errors) override {
    const std::size_t count = find(start, target);
    for (std::size_t i = 0; i < count; ++i) {
      if (!finish(branches_[order_[i]].angles, target)) continue;
      std::copy(state_.q.begin(), state_.q.end(), q);
      std::copy(state_.errors.begin(), state_.errors.end(), errors);
      return true;
    }
    return false;
  }

  std::size_t branches(const double* start, const double* target, double* poses) override {
    const std::size_t count = find(start, target);
    std::size_t kept = 0;
    for (std::size_t i = 0; i < count; ++i) {
      if (!finish(branches_[order_[i]].angles, target)) continue;
      double* pose = poses + ARM_PINS * kept;
      std::copy(state_.q.begin(), state_.q.end(), pose);
      kept += !known(poses, kept, pose);
    }
    return kept;
  }

 private:
  struct Branch {
    double angles[ARM_PINS], distance;
  };

  // Whether a pose equals an earlier one: branches merge at a singular pose.
  static bool known(const double* poses, std::size_t count, const double* pose) {
    for (std::size_t i = 0; i < count; ++i) {
      double largest = 0;
      for (std::size_t k = 0; k < ARM_PINS; ++k)
        largest = std::max(largest, std::fabs(poses[ARM_PINS * i + k] - pose[k]));
      if (largest < 1e-7) return true;
    }
    return false;
  }

  // Solutions of the equations within the limits, sorted by their distance from the start.
  std::size_t find(const double* start, const double* target) {
    branch_count_ = 0;
    constexpr int position = part_of<Position>(), orientation = part_of<Orientation>();
    const double* weights = target + WEIGHTS;
    if (!(weights[position] > 0) || !(weights[orientation] > 0)) return 0;
    start_ = start;
    double goal[9], back[9];
    to_matrix(target + COLUMNS[orientation], goal);
    for (int i = 0; i < 9; ++i) back[i] = arm_.unrotated[3 * (i % 3) + i / 3];
    multiply(goal, back, goal_);
    const Triple away = minus(arm_.wrist, arm_.tip);
    rotate(goal_, away.data(), wrist_.data());
    for (int i = 0; i < 3; ++i) wrist_[i] += target[COLUMNS[position] + i];
    if (arm_.kind == ArmKind::PARALLEL)
      parallel();
    else
      reach();
    std::iota(order_.begin(), order_.end(), 0);
    std::stable_sort(order_.begin(), order_.begin() + static_cast<std::ptrdiff_t>(branch_count_),
                     [&](std::size_t a, std::size_t b) {
                       return branches_[a].distance < branches_[b].distance;
                     });
    return branch_count_;
  }

  const Triple& axis(int n) const { return arm_.lines[n].axis; }
  const Triple& at(int n) const { return arm_.lines[n].at; }

  // A point after a rotation about an axis.
  Triple moved(int n, double angle, const Triple& point) const {
    return plus(at(n), turned(axis(n), angle, minus(point, at(n))));
  }

  Triple goal_turned(const Triple& v) const {
    Triple out;
    rotate(goal_, v.data(), out.data());
    return out;
  }

  Triple goal_undone(const Triple& v) const {
    Triple out;
    for (int i = 0; i < 3; ++i)
      out[i] = goal_[i] * v[0] + goal_[3 + i] * v[1] + goal_[6 + i] * v[2];
    return out;
  }

  // Distance of the wrist from its target, with the first rotation undone.
  Triple before_first(double angle) const { return moved(0, -angle, wrist_); }

  void reach() {
    switch (arm_.reach) {
      case Approach::LATER_PARALLEL:
        return later_parallel();
      case Approach::LATER_MEET:
        return later_meet();
      case Approach::EARLIER_MEET:
        return earlier_meet();
      case Approach::EARLIER_PARALLEL:
        return earlier_parallel();
      case Approach::NONE:
        return;
    }
  }

  // The component along the second and third axes determines the first angle.
  void later_parallel() {
    const double along = inner(axis(1), minus(arm_.wrist, at(0)));
    const Triple back = times(-1, axis(0));
    each(angles_along(back, minus(wrist_, at(0)), axis(1), along, SLACK, start_[0]),
         [&](double first) { in_plane(first, before_first(first), arm_.wrist); });
  }

  // Second and third angle, from the sides of a triangle.
  void in_plane(double first, const Triple& goal, const Triple& point) {
    const double far = size(minus(goal, at(1)));
    each(angles_at_distance(axis(2), minus(point, at(2)), minus(at(1), at(2)), far, SLACK,
                            start_[2]),
         [&](double third) {
           const Triple placed = moved(2, third, point);
           const double second =
               angle_between(axis(1), minus(placed, at(1)), minus(goal, at(1)), start_[1]);
           wrist(first, second, third);
         });
  }

  void later_meet() {
    const Triple& joint = arm_.joint;
    const Triple back = times(-1, axis(0));
    const double far = size(minus(arm_.wrist, joint));
    each(angles_at_distance(back, minus(wrist_, at(0)), minus(joint, at(0)), far, SLACK, start_[0]),
         [&](double first) {
           angles_to_common(times(-1, axis(1)), minus(before_first(first), joint), axis(2),
                            minus(arm_.wrist, joint), SLACK, start_[1], start_[2],
                            [&](double second, double third) { wrist(first, second, third); });
         });
  }

  void earlier_meet() {
    const Triple& joint = arm_.joint;
    const double far = size(minus(wrist_, joint));
    each(angles_at_distance(axis(2), minus(arm_.wrist, at(2)), minus(joint, at(2)), far, SLACK,
                            start_[2]),
         [&](double third) {
           const Triple placed = moved(2, third, arm_.wrist);
           angles_to_common(times(-1, axis(0)), minus(wrist_, joint), axis(1), minus(placed, joint),
                            SLACK, start_[0], start_[1],
                            [&](double first, double second) { wrist(first, second, third); });
         });
  }

  void earlier_parallel() {
    const double along = inner(axis(0), minus(wrist_, at(2)));
    each(angles_along(axis(2), minus(arm_.wrist, at(2)), axis(0), along, SLACK, start_[2]),
         [&](double third) {
           const Triple placed = moved(2, third, arm_.wrist);
           const double far = size(minus(wrist_, at(0)));
           each(angles_at_distance(axis(1), minus(placed, at(1)), minus(at(0), at(1)), far, SLACK,
                                   start_[1]),
                [&](double second) {
                  const Triple there = moved(1, second, placed);
                  const double first =
                      angle_between(axis(0), minus(there, at(0)), minus(wrist_, at(0)), start_[0]);
                  wrist(first, second, third);
                });
         });
  }

  // The last three angles, from the remaining rotation.
  void wrist(double first, double second, double third) {
    const auto left = [&](const Triple& v) {
      return turned(axis(2), -third, turned(axis(1), -second, turned(axis(0), -first, v)));
    };
    const Triple end = left(goal_turned(axis(5)));
    each(
        angles_along(axis(4), axis(5), axis(3), inner(axis(3), end), SLACK, start_[4]),
        [&](double fifth) {
          const Triple bent = turned(axis(4), fifth, axis(5));
          const double fourth = angle_between(axis(3), bent, end, start_[3]);
          // The vector farthest from the last axis compensates the error of the fourth angle.
          const Triple side = across(axis(5));
          const Triple goal = left(goal_turned(side));
          const Triple open = turned(axis(4), -fifth, turned(axis(3), -fourth, goal));
          add({first, second, third, fourth, fifth, angle_between(axis(5), side, open, start_[5])});
        });
  }

  static Triple across(const Triple& v) {
    int least = std::fabs(v[1]) < std::fabs(v[0]) ? 1 : 0;
    if (std::fabs(v[2]) < std::fabs(v[least])) least = 2;
    Triple unit{};
    unit[least] = 1;
    return crossed(v, unit);
  }

  // The first angle from the component along the parallel axes, the fifth from that of the last
  // axis.
  void parallel() {
    const Triple& normal = axis(1);
    const Triple back = times(-1, axis(0));
    const double along = inner(normal, minus(arm_.wrist, at(0)));
    const Triple end = goal_turned(axis(5));
    each(angles_along(back, minus(wrist_, at(0)), normal, along, SLACK, start_[0]),
         [&](double first) {
           const Triple goal = before_first(first);
           const double shown = inner(normal, turned(axis(0), -first, end));
           each(angles_along(axis(4), axis(5), normal, shown, SLACK, start_[4]),
                [&](double fifth) { parallel(first, fifth, goal); });
         });
  }

  void parallel(double first, double fifth, const Triple& goal) {
    const Triple& normal = axis(1);
    const Triple undone = goal_undone(turned(axis(0), first, normal));
    const double sixth = angle_between(axis(5), undone, turned(axis(4), -fifth, normal), start_[5]);
    // The sum of the three parallel rotations.
    const Triple side = across(normal);
    const Triple last = turned(axis(5), -sixth, turned(axis(4), -fifth, side));
    const Triple shown = turned(axis(0), -first, goal_turned(last));
    const double sum = angle_between(normal, side, shown, 0);
    const Triple elbow = minus(goal, turned(normal, sum, minus(arm_.wrist, at(3))));
    const double far = size(minus(elbow, at(1)));
    each(angles_at_distance(axis(2), minus(at(3), at(2)), minus(at(1), at(2)), far, SLACK,
                            start_[2]),
         [&](double third) {
           const Triple placed = moved(2, third, at(3));
           const double second =
               angle_between(normal, minus(placed, at(1)), minus(elbow, at(1)), start_[1]);
           add({first, second, third, sum - second - third, fifth, sixth});
         });
  }

  template <class Use>
  static void each(const Angles& angles, Use&& use) {
    for (int i = 0; i < angles.count; ++i) use(angles.values[i]);
  }

  // Stores a pose, each angle shifted by full turns to the one nearest to the start within limits.
  void add(const std::array<double, ARM_PINS>& angles) {
    if (branch_count_ == branches_.size()) return;
    Branch& pose = branches_[branch_count_];
    pose.distance = 0;
    for (std::size_t n = 0; n < ARM_PINS; ++n) {
      const double* limit = task_.chain.nodes[n].limit;
      double angle = angles[n] + REVOLUTION * std::nearbyint((start_[n] - angles[n]) / REVOLUTION);
      if (angle < limit[0] - SLACK)
        angle += REVOLUTION * std::ceil((limit[0] - SLACK - angle) / REVOLUTION);
      if (angle > limit[1] + SLACK)
        angle -= REVOLUTION * std::ceil((angle - limit[1] - SLACK) / REVOLUTION);
      if (!(angle >= limit[0] - SLACK)) return;
      pose.angles[n] = std::clamp(angle, limit[0], limit[1]);
      pose.distance += (angle - start_[n]) * (angle - start_[n]);
    }
    ++branch_count_;
  }

  double worst() const {
    const double* errors = state_.errors.data();
    return *std::max_element(errors, errors + PARTS);
  }

  void look_at(const double* q, const double* target) {
    std::copy(q, q + ARM_PINS, state_.q.begin());
    forward(task_.chain, state_.q.data(), state_.frames);
    measure(task_, target, state_);
  }

  // Sets state_ to the pose that Newton's method ends at; returns whether it reaches the target
  // within the limits.
  bool finish(const double* angles, const double* target) {
    double best[ARM_PINS], next[ARM_PINS], step[ARM_PINS];
    std::copy(angles, angles + ARM_PINS, best);
    look_at(best, target);
    double error = worst();
    for (int i = 0; i < ARM_STEPS && error > ARM_EXACT; ++i) {
      newton(target, step);
      for (std::size_t n = 0; n < ARM_PINS; ++n) {
        const double* limit = task_.chain.nodes[n].limit;
        next[n] = std::clamp(best[n] + step[n], limit[0], limit[1]);
      }
      look_at(next, target);
      const double now = worst();
      if (!(now < error)) break;
      const bool slow = now > error / 2;
      error = now;
      std::copy(next, next + ARM_PINS, best);
      if (slow) break;
    }
    look_at(best, target);
    const double* errors = state_.errors.data();
    for (int part = 0; part < PARTS; ++part)
      if (!(errors[part] <= tolerances_[METRIC[part] ? 0 : 1])) return false;
    return true;
  }

  // Solves J d = r with full pivoting; unknowns without a pivot stay 0.
  void newton(const double* target, double* step) {
    differentiate(task_, target, state_, linear_.columns);
    double rows[ARM_PINS][ARM_PINS + 1];
    std::size_t columns[ARM_PINS];
    for (std::size_t r = 0; r < ARM_PINS; ++r) {
      for (std::size_t c = 0; c < ARM_PINS; ++c) rows[r][c] = linear_.columns[c * ARM_PINS + r];
      rows[r][ARM_PINS] = state_.residuals[r];
      columns[r] = r;
    }
    std::size_t rank = 0;
    double first = 0;
    for (; rank < ARM_PINS; ++rank) {
      std::size_t row = rank, column = rank;
      for (std::size_t r = rank; r < ARM_PINS; ++r)
        for (std::size_t c = rank; c < ARM_PINS; ++c)
          if (std::fabs(rows[r][c]) > std::fabs(rows[row][column])) row = r, column = c;
      std::swap_ranges(rows[rank], rows[rank] + ARM_PINS + 1, rows[row]);
      if (column != rank) {
        for (auto& each : rows) std::swap(each[rank], each[column]);
        std::swap(columns[rank], columns[column]);
      }
      const double pivot = rows[rank][rank];
      if (rank == 0) first = std::fabs(pivot);
      if (!(std::fabs(pivot) > ARM_PIVOT * first)) break;
      for (std::size_t r = rank + 1; r < ARM_PINS; ++r) {
        const double cosine = rows[r][rank] / pivot;
        for (std::size_t c = rank; c <= ARM_PINS; ++c) rows[r][c] -= cosine * rows[rank][c];
      }
    }
    std::fill(step, step + ARM_PINS, 0.0);
    for (std::size_t r = rank; r-- > 0;) {
      double sum = rows[r][ARM_PINS];
      for (std::size_t c = r + 1; c < rank; ++c) sum -= rows[r][c] * step[columns[c]];
      step[columns[r]] = sum / rows[r][r];
    }
  }

  // By how much rounding and nearly parallel axes may put a target out of reach, as a fraction of
  // the length.
  static constexpr double SLACK = 1e-9;

  const Task& task_;
  const Anatomy arm_;
  const double tolerances_[2];
  State state_;
  Linearized linear_;
  double goal_[9];  // rotation of the last node from its pose at zero angles
  Triple wrist_;    // target of the wrist
  const double* start_ = nullptr;
  std::array<Branch, MAX_BRANCHES> branches_;
  std::array<std::size_t, MAX_BRANCHES> order_;
  std::size_t branch_count_ = 0;
};

}  // namespace

ArmKind arm_kind(const Task& task) { return look(task).kind; }

std::unique_ptr<Arm> make_arm(const Task& task, double length_tolerance, double angle_tolerance) {
  const Anatomy arm = look(task);
  if (arm.kind == ArmKind::NONE) return nullptr;
  return std::make_unique<SixPins>(task, arm, length_tolerance, angle_tolerance);
}

}  // namespace animtool::ik
