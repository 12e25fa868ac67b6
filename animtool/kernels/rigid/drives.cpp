// Drives of joints in a substep, and their effective masses.
#include "rigid/drives.h"

#include <algorithm>
#include <cmath>

#include "base/cholesky.h"

namespace animtool::rigid {

namespace {

// Phase of a swing in a substep above which it is damped, not resolved [rad].
constexpr double FARTHEST = 2;
// Decay exponent above which a motion is at rest.
constexpr double DECAYED = 20;
// Largest number of joint equations solved together, and around one drive in larger islands.
constexpr std::size_t TOGETHER = 96, NEAR = 48;
// Relative mass below which an equation is redundant; fully constrained bodies are this much
// heavier.
constexpr double IMPLIED = 1e-9, HELD = 1e6;
// Equations with less independent mass than the first converge slowly by iteration; below the
// second, a drive does not feel the mass behind it.
constexpr double APART = 0.02, KNOWN = 1e-3;

// Response of x'' = pull - stiffness x - damping x' after time 1, from rest at 0 or with a speed.
struct Response {
  double by_pull;   // twice the displacement
  double by_speed;  // displacement
  double decay;     // of speed
  double extra;     // 1 / by_pull - 1
  double lag;       // 1 - by_speed / by_pull
};

Response response_of(double stiffness, double damping) {
  Response found{};
  if (stiffness + damping <= 1) {
    // A power series, which keeps small differences exact.
    double before = 0, term = 0.5, rest = 0, lag = 0, by_speed = 1, decay = 1;
    for (int n = 2; n < 18; ++n) {
      const double next = -(stiffness * before + damping * n * term) / ((n + 1.0) * n);
      by_speed += (n + 1) * next, decay += (n + 1.0) * n * next;
      rest += 2 * next, lag -= (n - 1) * next;
      before = term, term = next;
    }
    found = {1 + rest, by_speed, decay, -rest / (1 + rest), lag / (1 + rest)};
    return found;
  }
  const double z = damping / 2, square = stiffness - z * z;
  if (square < -0.09) {
    const double r = std::sqrt(-square), fast = z + r, slow = stiffness / fast;
    const double far = std::exp(-slow), near = std::exp(-fast);
    const double mean = slow > 1e-8 ? -std::expm1(-slow) / slow : 1 - slow / 2;
    found.by_pull = (mean + std::expm1(-fast) / fast) / r;
    found.by_speed = (far - near) / (2 * r);
    found.decay = (fast * near - slow * far) / (2 * r);
  } else {
    const double e = std::exp(-z), r = std::sqrt(std::fabs(square));
    const bool swings = square > 0;
    const double sine = r < 1e-4 ? 1 - square / 6 : (swings ? std::sin(r) : std::sinh(r)) / r;
    found.by_speed = e * sine;
    found.decay = e * (swings ? std::cos(r) : std::cosh(r)) - z * found.by_speed;
    found.by_pull = 2 * (1 - found.decay - damping * found.by_speed) / stiffness;
  }
  found.extra = 1 / found.by_pull - 1, found.lag = 1 - found.by_speed / found.by_pull;
  return found;
}

// Angular frequency of a damped spring on a mass [1/s].
double swing(const Joint& joint, double mass) {
  const double z = joint.damping / mass / 2;
  return std::sqrt(std::max(joint.stiffness / mass - z * z, 0.0));
}

bool followed(const Joint& joint, const Drive& drive, double h) {
  return drive.known && drive.mass > 0 && swing(joint, drive.mass) * h <= FARTHEST;
}

// Inverse mass matrix of joint equations.
class Masses {
 public:
  explicit Masses(const std::vector<Speed>& speeds) : speeds_(speeds) {}

  // Returns the fraction of freedom that earlier equations leave it; at least that of a redundant
  // one.
  double add(const Joint& joint, const Row& row) {
    std::vector<double> line = coupled(joint, row);
    const double own = over(joint, row, joint, row);
    double left = own;
    for (const double value : line) left -= value * value;
    if (!(left > IMPLIED * own)) return IMPLIED;
    const double share = left / own;
    line.push_back(std::sqrt(left));
    lines_.push_back(std::move(line)), rows_.push_back({&joint, &row});
    return share;
  }

  // Speed change of a row by a unit impulse, with all equations constrained.
  double ease(const Joint& joint, const Row& row) const {
    const double own = over(joint, row, joint, row);
    double left = own;
    for (const double value : coupled(joint, row)) left -= value * value;
    return std::max(left, own / HELD);
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
      line[i] = over(joint, row, *rows_[i].joint, *rows_[i].row);
    cholesky::solve_forward<cholesky::Roots>([&](std::size_t i) { return lines_[i].data(); },
                                             line.size(), line.data());
    return line;
  }

  // Speed change of one row by a unit impulse of another.
  double over(const Joint& p, const Row& u, const Joint& q, const Row& v) const {
    double sum = 0;
    const auto meet = [&](std::size_t body, double sign, Vec arm_u, Vec arm_v) {
      const Speed& s = speeds_[body];
      sum += sign * (s.ease * dot(u.line, v.line) + dot(arm_u, s.turned(arm_v)));
    };
    if (p.b == q.b) meet(p.b, 1, u.arm_b, v.arm_b);
    if (p.a >= 0 && p.a == q.a) meet(static_cast<std::size_t>(p.a), 1, u.arm_a, v.arm_a);
    if (p.a >= 0 && static_cast<std::size_t>(p.a) == q.b) meet(q.b, -1, u.arm_a, v.arm_b);
    if (q.a >= 0 && static_cast<std::size_t>(q.a) == p.b) meet(p.b, -1, u.arm_b, v.arm_a);
    return sum;
  }

  const std::vector<Speed>& speeds_;
  std::vector<std::vector<double>> lines_;
  std::vector<Of> rows_;
};

// Independence of joint equations.
struct Condition {
  double least = 1;      // smallest of the independent ones
  bool implied = false;  // whether some are redundant

  void add(double share) {
    if (share > IMPLIED) least = std::min(least, share);
    else implied = true;
  }
};

void add_locks(Masses& to, Condition& condition, const Joint& joint, const Rows& rows) {
  for (std::size_t r = 0; r < rows.count; ++r)
    if (rows.of[r].kind == Row::LOCK) condition.add(to.add(joint, rows.of[r]));
}

bool share_body(const Joint& p, const Joint& q) {
  const auto has = [&](std::ptrdiff_t body) {
    return body >= 0 && (body == q.a || body == static_cast<std::ptrdiff_t>(q.b));
  };
  return has(p.a) || has(static_cast<std::ptrdiff_t>(p.b));
}

// The joints nearest to one of an island, itself first, up to a number of equations.
std::vector<std::size_t> near(const std::vector<Joint>& joints,
                              const std::vector<std::size_t>& island,
                              const std::vector<Rows>& rows, std::size_t begin) {
  std::vector<std::size_t> found{begin};
  std::vector<char> known(island.size(), 0);
  known[begin] = 1;
  std::size_t count = rows[begin].count;
  for (std::size_t i = 0; i < found.size(); ++i)
    for (std::size_t k = 0; k < island.size() && count < NEAR; ++k) {
      if (known[k] || !share_body(joints[island[found[i]]], joints[island[k]])) continue;
      known[k] = 1, count += rows[k].count;
      found.push_back(k);
    }
  return found;
}

// Fully constrained bodies are not pushed harder than a hard joint would.
void bound(const Drive& drive, Row& row) {
  const double most = drive.mass < row.mass * HELD / 2 ? row.give : row.mass;
  if (row.give > most) row.push *= most / row.give, row.give = most;
}

}  // namespace

double swing_of(const Joint& joint, double mass, double time) {
  if (!(mass > 0) || joint.damping / mass * time / 2 > DECAYED) return 0;
  return swing(joint, mass);
}

void begin_drive(const Joint& joint, Drive& drive, Row& row, double speed, double h) {
  drive.speed = speed, drive.error = row.error;
  const double pull = joint.stiffness * row.error - joint.damping * joint.speed;
  const double m = drive.mass;
  if (!followed(joint, drive, h)) {
    row.give = h / 2 * (joint.damping + h * joint.stiffness), row.push = h / 2 * pull;
    return bound(drive, row);
  }
  const Response to = response_of(joint.stiffness / m * h * h, joint.damping / m * h);
  row.give = m * to.extra;
  row.push = m * to.lag * speed + h / 2 * pull;
  bound(drive, row);
}

void end_drive(const Joint& joint, const Drive& drive, Row& row, double speed, double h) {
  const double m = drive.mass;
  if (!followed(joint, drive, h)) {
    const double pull = joint.stiffness * row.error - joint.damping * joint.speed;
    row.give = h * (joint.damping + h * joint.stiffness), row.push = h * pull;
    return bound(drive, row);
  }
  const double pull = (joint.stiffness * drive.error - joint.damping * joint.speed) / m;
  const Response to = response_of(joint.stiffness / m * h * h, joint.damping / m * h);
  const double others = speed - drive.speed - drive.first / m;
  const double after = to.decay * drive.speed - h * to.by_speed * pull +
                       (2 * to.by_speed - to.by_pull) * others;
  row.give = m * to.extra;
  row.push = m * (speed - after / to.by_pull) - drive.first;
  bound(drive, row);
}

bool find_masses(const std::vector<Joint>& joints, const std::vector<std::size_t>& island,
                 const std::vector<Rows>& rows, const std::vector<Speed>& speeds,
                 std::vector<Drives>& drives) {
  std::size_t count = 0;
  for (const Rows& own : rows) count += own.count;
  const bool whole = count <= TOGETHER;
  Masses all(speeds);
  Condition condition;
  for (std::size_t k = 0; whole && k < island.size(); ++k)
    add_locks(all, condition, joints[island[k]], rows[k]);
  for (std::size_t k = 0; k < island.size(); ++k) {
    const Joint& joint = joints[island[k]];
    if (!driven(joint)) continue;
    Masses some(speeds);
    Condition own = condition;
    if (!whole)
      for (const std::size_t i : near(joints, island, rows, k))
        add_locks(some, own, joints[island[i]], rows[i]);
    for (std::size_t r = 0; r < rows[k].count; ++r) {
      const Row& row = rows[k].of[r];
      if (row.kind != Row::DRIVE) continue;
      Drive& drive = drives[k][static_cast<std::size_t>(row.slot - SLOT_DRIVE)];
      drive.mass = 1 / (whole ? all : some).ease(joint, row);
      drive.known = own.least > KNOWN;
    }
  }
  return whole && !condition.implied && condition.least > APART;
}

}  // namespace animtool::rigid
