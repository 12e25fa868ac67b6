// Drives of joints in a substep, and their effective masses.
#include "rigid/drives.h"

#include <algorithm>
#include <cmath>

#include "base/cholesky.h"

namespace animtool::rigid {

namespace {

// Phase of an oscillation in a substep above which it is damped, not resolved [rad].
constexpr double MAX_RESOLVED_PHASE = 2;
// Decay exponent above which a motion has come to rest.
constexpr double MAX_DECAY_EXPONENT = 20;
// Largest number of joint equations that are solved together; the same around one drive in larger
// islands.
constexpr std::size_t MAX_EQUATIONS = 96, MAX_NEAR_EQUATIONS = 48;
// Relative inverse mass below which an equation is redundant; factor by which fully constrained
// bodies count as heavier.
constexpr double REDUNDANT_INDEPENDENCE = 1e-9, FIXED_MASS_FACTOR = 1e6;
// If equations have less independent mass than the first value, iterations converge slowly; below
// the second value, a drive does not move the mass behind it.
constexpr double WELL_CONDITIONED_INDEPENDENCE = 0.02, MIN_INDEPENDENCE = 1e-3;

// Response of x'' = acceleration - stiffness x - damping x' after time 1, from rest at 0, or with
// an initial speed.
struct Response {
  double acceleration_response;  // twice the displacement by a constant acceleration
  double speed_response;         // displacement by an initial speed
  double speed_decay;            // of the initial speed
  double mass_excess;            // 1 / acceleration_response - 1
  double response_deficit;       // 1 - speed_response / acceleration_response
};

Response compute_response(double stiffness, double damping) {
  Response response{};
  if (stiffness + damping <= 1) {
    // A power series, which keeps small differences exact.
    double previous_term = 0, term = 0.5, pull_excess = 0, response_deficit = 0, speed_response = 1,
           speed_decay = 1;
    for (int n = 2; n < 18; ++n) {
      const double next = -(stiffness * previous_term + damping * n * term) / ((n + 1.0) * n);
      speed_response += (n + 1) * next, speed_decay += (n + 1.0) * n * next;
      pull_excess += 2 * next, response_deficit -= (n - 1) * next;
      previous_term = term, term = next;
    }
    response = {1 + pull_excess, speed_response, speed_decay, -pull_excess / (1 + pull_excess),
                response_deficit / (1 + pull_excess)};
    return response;
  }
  const double z = damping / 2, discriminant = stiffness - z * z;
  if (discriminant < -0.09) {
    const double r = std::sqrt(-discriminant), fast_rate = z + r, slow_rate = stiffness / fast_rate;
    const double slow_decay = std::exp(-slow_rate), fast_decay = std::exp(-fast_rate);
    const double mean = slow_rate > 1e-8 ? -std::expm1(-slow_rate) / slow_rate : 1 - slow_rate / 2;
    response.acceleration_response = (mean + std::expm1(-fast_rate) / fast_rate) / r;
    response.speed_response = (slow_decay - fast_decay) / (2 * r);
    response.speed_decay = (fast_rate * fast_decay - slow_rate * slow_decay) / (2 * r);
  } else {
    const double envelope = std::exp(-z), r = std::sqrt(std::fabs(discriminant));
    const bool is_oscillating = discriminant > 0;
    const double sine =
        r < 1e-4 ? 1 - discriminant / 6 : (is_oscillating ? std::sin(r) : std::sinh(r)) / r;
    response.speed_response = envelope * sine;
    response.speed_decay =
        envelope * (is_oscillating ? std::cos(r) : std::cosh(r)) - z * response.speed_response;
    response.acceleration_response =
        2 * (1 - response.speed_decay - damping * response.speed_response) / stiffness;
  }
  response.mass_excess = 1 / response.acceleration_response - 1,
  response.response_deficit = 1 - response.speed_response / response.acceleration_response;
  return response;
}

// Angular frequency of a damped spring on a mass [1/s].
double damped_frequency(const Joint& joint, double mass) {
  const double z = joint.damping / mass / 2;
  return std::sqrt(std::max(joint.stiffness / mass - z * z, 0.0));
}

// Whether substeps resolve the oscillation of a drive.
bool is_resolved(const Joint& joint, const Drive& drive, double h) {
  return drive.is_mass_free && drive.mass > 0 &&
         damped_frequency(joint, drive.mass) * h <= MAX_RESOLVED_PHASE;
}

// Inverse mass matrix of joint equations.
class InverseMassMatrix {
 public:
  explicit InverseMassMatrix(const std::vector<Speed>& speeds) : speeds_(speeds) {}

  // Adds an equation. Returns its independence: the fraction of its inverse mass that earlier
  // equations leave; at least that of a redundant equation.
  double add(const Joint& joint, const Row& row) {
    std::vector<double> factor_row = compute_factor_row(joint, row);
    const double diagonal = coupling(joint, row, joint, row);
    double pivot = diagonal;
    for (const double value : factor_row) pivot -= value * value;
    if (!(pivot > REDUNDANT_INDEPENDENCE * diagonal)) return REDUNDANT_INDEPENDENCE;
    const double independence = pivot / diagonal;
    factor_row.push_back(std::sqrt(pivot));
    factor_rows_.push_back(std::move(factor_row)), rows_.push_back({&joint, &row});
    return independence;
  }

  // Speed change of a row by a unit impulse, with all added equations as constraints.
  double inverse_mass(const Joint& joint, const Row& row) const {
    const double diagonal = coupling(joint, row, joint, row);
    double pivot = diagonal;
    for (const double value : compute_factor_row(joint, row)) pivot -= value * value;
    return std::max(pivot, diagonal / FIXED_MASS_FACTOR);
  }

 private:
  struct Equation {
    const Joint* joint;
    const Row* row;
  };

  // Computes a row of the Cholesky factor, without its diagonal.
  std::vector<double> compute_factor_row(const Joint& joint, const Row& row) const {
    std::vector<double> factor_row(rows_.size());
    for (std::size_t i = 0; i < rows_.size(); ++i)
      factor_row[i] = coupling(joint, row, *rows_[i].joint, *rows_[i].row);
    cholesky::solve_forward<cholesky::Roots>([&](std::size_t i) { return factor_rows_[i].data(); },
                                             factor_row.size(), factor_row.data());
    return factor_row;
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
  std::vector<std::vector<double>> factor_rows_;
  std::vector<Equation> rows_;
};

// How independent joint equations are.
struct Conditioning {
  double min_independence = 1;           // of equations that are not redundant
  bool has_redundant_equations = false;  // whether some are redundant

  void add(double independence) {
    if (independence > REDUNDANT_INDEPENDENCE)
      min_independence = std::min(min_independence, independence);
    else
      has_redundant_equations = true;
  }
};

// Adds the equations of a joint that are always active.
void add_lock_equations(InverseMassMatrix& matrix, Conditioning& conditioning, const Joint& joint,
                        const Rows& rows) {
  for (std::size_t r = 0; r < rows.count; ++r)
    if (rows.entries[r].kind == Row::LOCK) conditioning.add(matrix.add(joint, rows.entries[r]));
}

bool have_common_body(const Joint& p, const Joint& q) {
  const auto is_body_of_q = [&](std::ptrdiff_t body) {
    return body >= 0 && (body == q.a || body == static_cast<std::ptrdiff_t>(q.b));
  };
  return is_body_of_q(p.a) || is_body_of_q(static_cast<std::ptrdiff_t>(p.b));
}

// The joints nearest to a joint of an island, starting with itself, up to a number of equations.
std::vector<std::size_t> nearest_joints(const std::vector<Joint>& joints,
                                        const std::vector<std::size_t>& island,
                                        const std::vector<Rows>& rows, std::size_t begin) {
  std::vector<std::size_t> nearest{begin};
  std::vector<char> is_visited(island.size(), 0);
  is_visited[begin] = 1;
  std::size_t count = rows[begin].count;
  for (std::size_t i = 0; i < nearest.size(); ++i)
    for (std::size_t k = 0; k < island.size() && count < MAX_NEAR_EQUATIONS; ++k) {
      if (is_visited[k] || !have_common_body(joints[island[nearest[i]]], joints[island[k]]))
        continue;
      is_visited[k] = 1, count += rows[k].count;
      nearest.push_back(k);
    }
  return nearest;
}

// Limits the impulse of a drive, so that fully constrained bodies are not pushed harder than by a
// rigid joint.
void limit_impulse(const Drive& drive, Row& row) {
  const double max_gain = drive.mass < row.mass * FIXED_MASS_FACTOR / 2 ? row.speed_gain : row.mass;
  if (row.speed_gain > max_gain)
    row.position_impulse *= max_gain / row.speed_gain, row.speed_gain = max_gain;
}

}  // namespace

double drive_frequency(const Joint& joint, double mass, double time) {
  if (!(mass > 0) || joint.damping / mass * time / 2 > MAX_DECAY_EXPONENT) return 0;
  return damped_frequency(joint, mass);
}

void begin_drive(const Joint& joint, Drive& drive, Row& row, double speed, double h) {
  drive.speed = speed, drive.error = row.error;
  const double force = joint.stiffness * row.error - joint.damping * joint.speed;
  const double mass = drive.mass;
  if (!is_resolved(joint, drive, h)) {
    row.speed_gain = h / 2 * (joint.damping + h * joint.stiffness),
    row.position_impulse = h / 2 * force;
    return limit_impulse(drive, row);
  }
  const Response response =
      compute_response(joint.stiffness / mass * h * h, joint.damping / mass * h);
  row.speed_gain = mass * response.mass_excess;
  row.position_impulse = mass * response.response_deficit * speed + h / 2 * force;
  limit_impulse(drive, row);
}

void end_drive(const Joint& joint, const Drive& drive, Row& row, double speed, double h) {
  const double mass = drive.mass;
  if (!is_resolved(joint, drive, h)) {
    const double force = joint.stiffness * row.error - joint.damping * joint.speed;
    row.speed_gain = h * (joint.damping + h * joint.stiffness), row.position_impulse = h * force;
    return limit_impulse(drive, row);
  }
  const double acceleration = (joint.stiffness * drive.error - joint.damping * joint.speed) / mass;
  const Response response =
      compute_response(joint.stiffness / mass * h * h, joint.damping / mass * h);
  const double other_speed = speed - drive.speed - drive.first_impulse / mass;
  const double end_speed =
      response.speed_decay * drive.speed - h * response.speed_response * acceleration +
      (2 * response.speed_response - response.acceleration_response) * other_speed;
  row.speed_gain = mass * response.mass_excess;
  row.position_impulse =
      mass * (speed - end_speed / response.acceleration_response) - drive.first_impulse;
  limit_impulse(drive, row);
}

bool update_drive_masses(const std::vector<Joint>& joints, const std::vector<std::size_t>& island,
                         const std::vector<Rows>& rows, const std::vector<Speed>& speeds,
                         std::vector<Drives>& drives) {
  std::size_t count = 0;
  for (const Rows& joint_rows : rows) count += joint_rows.count;
  const bool is_solved_as_one = count <= MAX_EQUATIONS;
  InverseMassMatrix island_matrix(speeds);
  Conditioning conditioning;
  for (std::size_t k = 0; is_solved_as_one && k < island.size(); ++k)
    add_lock_equations(island_matrix, conditioning, joints[island[k]], rows[k]);
  for (std::size_t k = 0; k < island.size(); ++k) {
    const Joint& joint = joints[island[k]];
    if (!has_drive(joint)) continue;
    InverseMassMatrix joint_matrix(speeds);
    Conditioning joint_conditioning = conditioning;
    if (!is_solved_as_one)
      for (const std::size_t i : nearest_joints(joints, island, rows, k))
        add_lock_equations(joint_matrix, joint_conditioning, joints[island[i]], rows[i]);
    for (std::size_t r = 0; r < rows[k].count; ++r) {
      const Row& row = rows[k].entries[r];
      if (row.kind != Row::DRIVE) continue;
      Drive& drive = drives[k][static_cast<std::size_t>(row.slot - SLOT_DRIVE)];
      drive.mass = 1 / (is_solved_as_one ? island_matrix : joint_matrix).inverse_mass(joint, row);
      drive.is_mass_free = joint_conditioning.min_independence > MIN_INDEPENDENCE;
    }
  }
  return is_solved_as_one && !conditioning.has_redundant_equations &&
         conditioning.min_independence > WELL_CONDITIONED_INDEPENDENCE;
}

}  // namespace animtool::rigid
