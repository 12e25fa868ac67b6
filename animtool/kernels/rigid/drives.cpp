// Drives of joints in a substep, and their effective masses.
#include "rigid/drives.h"

#include <algorithm>
#include <cmath>

#include "base/cholesky.h"

namespace animtool::rigid {

namespace {

// Phase of a swing in a substep above which it is damped, not resolved [rad].
constexpr double MAX_PHASE = 2;
// Decay exponent above which a motion is at rest.
constexpr double DECAYED = 20;
// Largest number of joint equations solved together, and around one drive in larger islands.
constexpr std::size_t MAX_EQUATIONS = 96, MAX_NEAR_EQUATIONS = 48;
// Relative mass below which an equation is redundant; fully constrained bodies are this much
// heavier.
constexpr double REDUNDANT = 1e-9, FIXED_MASS = 1e6;
// Equations with less independent mass than the first converge slowly by iteration; below the
// second, a drive does not feel the mass behind it.
constexpr double INDEPENDENT = 0.02, MIN_INDEPENDENCE = 1e-3;

// Response of x'' = pull - stiffness x - damping x' after time 1, from rest at 0 or with a speed.
struct Response {
  double by_pull;   // twice the displacement
  double by_speed;  // displacement
  double decay;     // of speed
  double extra;     // 1 / by_pull - 1
  double lag;       // 1 - by_speed / by_pull
};

Response response_of(double stiffness, double damping) {
  Response response{};
  if (stiffness + damping <= 1) {
    // A power series, which keeps small differences exact.
    double before = 0, term = 0.5, rest = 0, lag = 0, by_speed = 1, decay = 1;
    for (int n = 2; n < 18; ++n) {
      const double next = -(stiffness * before + damping * n * term) / ((n + 1.0) * n);
      by_speed += (n + 1) * next, decay += (n + 1.0) * n * next;
      rest += 2 * next, lag -= (n - 1) * next;
      before = term, term = next;
    }
    response = {1 + rest, by_speed, decay, -rest / (1 + rest), lag / (1 + rest)};
    return response;
  }
  const double z = damping / 2, square = stiffness - z * z;
  if (square < -0.09) {
    const double r = std::sqrt(-square), fast = z + r, slow = stiffness / fast;
    const double far = std::exp(-slow), near = std::exp(-fast);
    const double mean = slow > 1e-8 ? -std::expm1(-slow) / slow : 1 - slow / 2;
    response.by_pull = (mean + std::expm1(-fast) / fast) / r;
    response.by_speed = (far - near) / (2 * r);
    response.decay = (fast * near - slow * far) / (2 * r);
  } else {
    const double e = std::exp(-z), r = std::sqrt(std::fabs(square));
    const bool swings = square > 0;
    const double sine = r < 1e-4 ? 1 - square / 6 : (swings ? std::sin(r) : std::sinh(r)) / r;
    response.by_speed = e * sine;
    response.decay = e * (swings ? std::cos(r) : std::cosh(r)) - z * response.by_speed;
    response.by_pull = 2 * (1 - response.decay - damping * response.by_speed) / stiffness;
  }
  response.extra = 1 / response.by_pull - 1,
  response.lag = 1 - response.by_speed / response.by_pull;
  return response;
}

// Angular frequency of a damped spring on a mass [1/s].
double damped_frequency(const Joint& joint, double mass) {
  const double z = joint.damping / mass / 2;
  return std::sqrt(std::max(joint.stiffness / mass - z * z, 0.0));
}

bool is_resolved(const Joint& joint, const Drive& drive, double h) {
  return drive.moves_mass && drive.mass > 0 && damped_frequency(joint, drive.mass) * h <= MAX_PHASE;
}

// Inverse mass matrix of joint equations.
class InverseMassMatrix {
 public:
  explicit InverseMassMatrix(const std::vector<Speed>& speeds) : speeds_(speeds) {}

  // Returns the fraction of freedom that earlier equations leave it; at least that of a redundant
  // one.
  double add(const Joint& joint, const Row& row) {
    std::vector<double> line = coupled(joint, row);
    const double diagonal = coupling(joint, row, joint, row);
    double pivot = diagonal;
    for (const double value : line) pivot -= value * value;
    if (!(pivot > REDUNDANT * diagonal)) return REDUNDANT;
    const double independence = pivot / diagonal;
    line.push_back(std::sqrt(pivot));
    lines_.push_back(std::move(line)), rows_.push_back({&joint, &row});
    return independence;
  }

  // Speed change of a row by a unit impulse, with all equations constrained.
  double inverse_mass(const Joint& joint, const Row& row) const {
    const double diagonal = coupling(joint, row, joint, row);
    double pivot = diagonal;
    for (const double value : coupled(joint, row)) pivot -= value * value;
    return std::max(pivot, diagonal / FIXED_MASS);
  }

 private:
  struct Of {
    const Joint* joint;
    const Row* row;
  };

  // A row of the Cholesky factor, without its diagonal.
  std::vector<double> coupled(const Joint& joint, const Row& row) const {
    std::vector<double> line(rows_.size());
    for (std::size_t i = 0; i < rows_.size(); ++i)
      line[i] = coupling(joint, row, *rows_[i].joint, *rows_[i].row);
    cholesky::solve_forward<cholesky::Roots>([&](std::size_t i) { return lines_[i].data(); },
                                             line.size(), line.data());
    return line;
  }

  // Speed change of one row by a unit impulse of another.
  double coupling(const Joint& p, const Row& u, const Joint& q, const Row& v) const {
    double sum = 0;
    const auto add_shared_body = [&](std::size_t body, double sign, Vec arm_u, Vec arm_v) {
      const Speed& s = speeds_[body];
      sum += sign * (s.inverse_mass * dot(u.line, v.line) + dot(arm_u, s.angular_response(arm_v)));
    };
    if (p.b == q.b) add_shared_body(p.b, 1, u.arm_b, v.arm_b);
    if (p.a >= 0 && p.a == q.a) add_shared_body(static_cast<std::size_t>(p.a), 1, u.arm_a, v.arm_a);
    if (p.a >= 0 && static_cast<std::size_t>(p.a) == q.b)
      add_shared_body(q.b, -1, u.arm_a, v.arm_b);
    if (q.a >= 0 && static_cast<std::size_t>(q.a) == p.b)
      add_shared_body(p.b, -1, u.arm_b, v.arm_a);
    return sum;
  }

  const std::vector<Speed>& speeds_;
  std::vector<std::vector<double>> lines_;
  std::vector<Of> rows_;
};

// Independence of joint equations.
struct Condition {
  double least = 1;            // smallest of the independent ones
  bool has_redundant = false;  // whether some are redundant

  void add(double independence) {
    if (independence > REDUNDANT)
      least = std::min(least, independence);
    else
      has_redundant = true;
  }
};

void add_locks(InverseMassMatrix& to, Condition& condition, const Joint& joint, const Rows& rows) {
  for (std::size_t r = 0; r < rows.count; ++r)
    if (rows.of[r].kind == Row::LOCK) condition.add(to.add(joint, rows.of[r]));
}

bool have_common_body(const Joint& p, const Joint& q) {
  const auto has = [&](std::ptrdiff_t body) {
    return body >= 0 && (body == q.a || body == static_cast<std::ptrdiff_t>(q.b));
  };
  return has(p.a) || has(static_cast<std::ptrdiff_t>(p.b));
}

// The joints nearest to one of an island, itself first, up to a number of equations.
std::vector<std::size_t> nearest_joints(const std::vector<Joint>& joints,
                                        const std::vector<std::size_t>& island,
                                        const std::vector<Rows>& rows, std::size_t begin) {
  std::vector<std::size_t> nearest{begin};
  std::vector<char> known(island.size(), 0);
  known[begin] = 1;
  std::size_t count = rows[begin].count;
  for (std::size_t i = 0; i < nearest.size(); ++i)
    for (std::size_t k = 0; k < island.size() && count < MAX_NEAR_EQUATIONS; ++k) {
      if (known[k] || !have_common_body(joints[island[nearest[i]]], joints[island[k]])) continue;
      known[k] = 1, count += rows[k].count;
      nearest.push_back(k);
    }
  return nearest;
}

// Fully constrained bodies are not pushed harder than a hard joint would.
void limit_push(const Drive& drive, Row& row) {
  const double max_give = drive.mass < row.mass * FIXED_MASS / 2 ? row.give : row.mass;
  if (row.give > max_give) row.push *= max_give / row.give, row.give = max_give;
}

}  // namespace

double frequency_of(const Joint& joint, double mass, double time) {
  if (!(mass > 0) || joint.damping / mass * time / 2 > DECAYED) return 0;
  return damped_frequency(joint, mass);
}

void begin_drive(const Joint& joint, Drive& drive, Row& row, double speed, double h) {
  drive.speed = speed, drive.error = row.error;
  const double pull = joint.stiffness * row.error - joint.damping * joint.speed;
  const double m = drive.mass;
  if (!is_resolved(joint, drive, h)) {
    row.give = h / 2 * (joint.damping + h * joint.stiffness), row.push = h / 2 * pull;
    return limit_push(drive, row);
  }
  const Response to = response_of(joint.stiffness / m * h * h, joint.damping / m * h);
  row.give = m * to.extra;
  row.push = m * to.lag * speed + h / 2 * pull;
  limit_push(drive, row);
}

void end_drive(const Joint& joint, const Drive& drive, Row& row, double speed, double h) {
  const double m = drive.mass;
  if (!is_resolved(joint, drive, h)) {
    const double pull = joint.stiffness * row.error - joint.damping * joint.speed;
    row.give = h * (joint.damping + h * joint.stiffness), row.push = h * pull;
    return limit_push(drive, row);
  }
  const double pull = (joint.stiffness * drive.error - joint.damping * joint.speed) / m;
  const Response to = response_of(joint.stiffness / m * h * h, joint.damping / m * h);
  const double others = speed - drive.speed - drive.first_impulse / m;
  const double after =
      to.decay * drive.speed - h * to.by_speed * pull + (2 * to.by_speed - to.by_pull) * others;
  row.give = m * to.extra;
  row.push = m * (speed - after / to.by_pull) - drive.first_impulse;
  limit_push(drive, row);
}

bool update_drive_masses(const std::vector<Joint>& joints, const std::vector<std::size_t>& island,
                         const std::vector<Rows>& rows, const std::vector<Speed>& speeds,
                         std::vector<Drives>& drives) {
  std::size_t count = 0;
  for (const Rows& each : rows) count += each.count;
  const bool complete = count <= MAX_EQUATIONS;
  InverseMassMatrix all(speeds);
  Condition condition;
  for (std::size_t k = 0; complete && k < island.size(); ++k)
    add_locks(all, condition, joints[island[k]], rows[k]);
  for (std::size_t k = 0; k < island.size(); ++k) {
    const Joint& joint = joints[island[k]];
    if (!driven(joint)) continue;
    InverseMassMatrix some(speeds);
    Condition around = condition;
    if (!complete)
      for (const std::size_t i : nearest_joints(joints, island, rows, k))
        add_locks(some, around, joints[island[i]], rows[i]);
    for (std::size_t r = 0; r < rows[k].count; ++r) {
      const Row& row = rows[k].of[r];
      if (row.kind != Row::DRIVE) continue;
      Drive& drive = drives[k][static_cast<std::size_t>(row.slot - SLOT_DRIVE)];
      drive.mass = 1 / (complete ? all : some).inverse_mass(joint, row);
      drive.moves_mass = around.least > MIN_INDEPENDENCE;
    }
  }
  return complete && !condition.has_redundant && condition.least > INDEPENDENT;
}

}  // namespace animtool::rigid
