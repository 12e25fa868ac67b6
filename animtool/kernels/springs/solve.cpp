// Implicit Euler and BDF2 steps of networks of springs: Newton's method, whose equations
// are solved by conjugate gradients without a matrix; those of chains directly.
//
// D. Baraff, A. Witkin, Large Steps in Cloth Simulation, 1998; K.-J. Choi, H.-S. Ko, Stable but
// Responsive Cloth, 2002 (the negative transverse stiffness of compressed springs is omitted, so
// that the matrix stays positive definite).
#include <algorithm>
#include <tuple>
#include <utility>

#include "base/checks.h"
#include "springs/chain.h"
#include "springs/steps.h"

namespace animtool {

namespace {

// Largest number of Newton corrections of a step, of halvings of a correction, and of times that
// the number of steps of an interval is doubled.
constexpr int MAX_CORRECTIONS = 40, MAX_HALVINGS = 8, MAX_DOUBLINGS = 6;
// Largest number of matrix products of a conjugate gradient solve.
constexpr int MAX_MATRIX_PRODUCTS = 400;
// Relative residual at which conjugate gradients stop: the next correction removes the remainder.
constexpr double CG_TOLERANCE = 1e-3;

// The stiffness of a spring in a step: transverse in all directions, plus axial along its
// direction.
struct SpringStiffness {
  std::int32_t i, j;
  double transverse, axial, direction[3];
};

class ImplicitSolver {
 public:
  ImplicitSolver(SpringRun& run, double tolerance)
      : run_(run),
        tolerance_(tolerance),
        residual_(run.size),
        correction_(run.size),
        r_(run.size),
        z_(run.size),
        p_(run.size),
        q_(run.size),
        blocks_(9 * run.network.particle_count()),
        trial_x_(run.size),
        trial_v_(run.size) {}

  // Solves m (bv - v) + s F(bx + s v, v) = 0 for v, starting from run.v; returns whether it
  // converged.
  bool solve(const std::vector<double>& bx, const std::vector<double>& bv, double s, double t) {
    set_pinned(bx, s, t, run_.v);
    compute_positions(bx, s, run_.v, run_.x);
    double residual_size = compute_residual(bv, s, run_.x, run_.v);
    for (int i = 0; i < MAX_CORRECTIONS; ++i) {
      ++corrections;
      assemble_stiffness(s);
      const double max_change = solve_correction();
      double fraction = 1, trial_size = 0;
      for (int halving = 0; halving < MAX_HALVINGS; ++halving, fraction /= 2) {
        for (std::size_t k = 0; k < run_.size; ++k)
          trial_v_[k] = run_.v[k] + fraction * correction_[k];
        compute_positions(bx, s, trial_v_, trial_x_);
        trial_size = compute_residual(bv, s, trial_x_, trial_v_);
        if (trial_size <= 4 * residual_size || residual_size == 0) break;
      }
      run_.v.swap(trial_v_);
      run_.x.swap(trial_x_);
      residual_size = trial_size;
      if (!(max_change < HUGE_VAL)) return false;
      if (fraction == 1 && max_change * s <= tolerance_) return true;
    }
    return false;
  }

  std::int64_t corrections = 0;

 private:
  // Sets pinned particles to their track.
  void set_pinned(const std::vector<double>& bx, double s, double t, std::vector<double>& v) {
    run_.network.set_pinned(t, s, bx.data(), trial_x_.data(), v.data());
  }

  void compute_positions(const std::vector<double>& bx, double s, const std::vector<double>& v,
                         std::vector<double>& x) const {
    for (std::size_t k = 0; k < run_.size; ++k) x[k] = bx[k] + s * v[k];
  }

  // Computes the residual; returns its square over the masses.
  double compute_residual(const std::vector<double>& bv, double s, const std::vector<double>& x,
                          const std::vector<double>& v) {
    run_.accelerate(x.data(), v.data(), residual_.data());
    double sum = 0;
    for (std::size_t n = 0; n < run_.network.particle_count(); ++n) {
      const double inverse_mass = run_.network.inverse_masses[n];
      for (std::size_t k = PARTICLE_STRIDE * n; k < PARTICLE_STRIDE * n + 3; ++k) {
        if (inverse_mass == 0) {
          residual_[k] = 0;
          continue;
        }
        const double velocity_residual = bv[k] - v[k] + s * residual_[k];
        residual_[k] = velocity_residual / inverse_mass;
        sum += velocity_residual * residual_[k];
      }
    }
    return sum;
  }

  // Assembles the blocks and springs of the matrix; factors it for chains, else inverts the blocks.
  void assemble_stiffness(double s) {
    const SpringNetwork& network = run_.network;
    springs_.clear();
    for (std::size_t n = 0; n < network.particle_count(); ++n) {
      double* block = blocks_.data() + 9 * n;
      std::fill_n(block, 9, 0.0);
      const double inverse_mass = network.inverse_masses[n];
      const double diagonal = inverse_mass > 0 ? (1 + s * network.drags[n]) / inverse_mass : 1;
      for (int k = 0; k < 3; ++k) block[4 * k] = diagonal;
    }
    for (std::size_t a = 0; a < network.anchors.size(); ++a) {
      double* block = blocks_.data() + 9 * static_cast<std::size_t>(network.anchors[a]);
      for (int k = 0; k < 3; ++k)
        block[4 * k] += s * s * network.anchor_stiffness[a] + s * network.anchor_damping[a];
    }
    add_air_damping(s);
    diagonal_.resize(network.particle_count());
    for (std::size_t n = 0; n < network.particle_count(); ++n) diagonal_[n] = blocks_[9 * n];
    for (const Spring& spring : run_.spring_set().springs) add_spring(spring, s);
    bandwidth_ = 0;
    for (const SpringStiffness& spring : springs_)
      bandwidth_ = std::max(bandwidth_, static_cast<std::size_t>(std::abs(spring.i - spring.j)));
    if (is_chain()) return factor_chain();
    for (std::size_t n = 0; n < network.particle_count(); ++n) invert(blocks_.data() + 9 * n);
  }

  bool is_chain() const { return bandwidth_ <= MAX_CHAIN_WIDTH; }

  void factor_chain() {
    const SpringNetwork& network = run_.network;
    chain_.reset(network.particle_count(), bandwidth_);
    for (std::size_t n = 0; n < network.particle_count(); ++n)
      for (std::size_t row = 0; row < 3; ++row)
        for (std::size_t column = 0; column < 3; ++column)
          chain_.add(3 * n + row, 3 * n + column, blocks_[9 * n + 3 * row + column]);
    for (const SpringStiffness& spring : springs_) {
      const auto [low, high] = std::minmax(spring.i, spring.j);
      const std::size_t i = static_cast<std::size_t>(low), j = static_cast<std::size_t>(high);
      // Pinned particles do not move, so they are not coupled.
      if (network.inverse_masses[i] == 0 || network.inverse_masses[j] == 0) continue;
      for (std::size_t row = 0; row < 3; ++row)
        for (std::size_t column = 0; column < 3; ++column)
          chain_.add(3 * j + row, 3 * i + column,
                     -(spring.axial * spring.direction[row] * spring.direction[column] +
                       (row == column ? spring.transverse : 0)));
    }
    chain_.factor();
  }

  // Adds a bound of the damping by air to the blocks.
  void add_air_damping(double s) {
    const SpringNetwork& network = run_.network;
    const double bound = std::abs(network.air_drag) + std::abs(network.air_lift);
    if (bound == 0) return;
    const double *x = run_.x.data(), *v = run_.v.data();
    for (std::size_t t = 0; t < network.triangles.size(); t += 3) {
      const std::int32_t* corners = network.triangles.data() + t;
      const std::size_t rows[3] = {PARTICLE_STRIDE * static_cast<std::size_t>(corners[0]),
                                   PARTICLE_STRIDE * static_cast<std::size_t>(corners[1]),
                                   PARTICLE_STRIDE * static_cast<std::size_t>(corners[2])};
      double a[3], b[3], flow[3];
      for (std::size_t k = 0; k < 3; ++k) {
        a[k] = x[rows[1] + k] - x[rows[0] + k];
        b[k] = x[rows[2] + k] - x[rows[0] + k];
        flow[k] = run_.wind[k] - (v[rows[0] + k] + v[rows[1] + k] + v[rows[2] + k]) / 3;
      }
      const double n[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                           a[0] * b[1] - a[1] * b[0]};
      const double damping =
          s * 2 * bound * std::sqrt(dot3(flow, flow)) * std::sqrt(dot3(n, n)) / 6;
      for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 3; ++k)
          blocks_[9 * static_cast<std::size_t>(corners[c]) + 4 * static_cast<std::size_t>(k)] +=
              damping;
    }
  }

  void add_spring(const Spring& spring, double s) {
    const double* p = run_.x.data() + PARTICLE_STRIDE * static_cast<std::size_t>(spring.i);
    const double* q = run_.x.data() + PARTICLE_STRIDE * static_cast<std::size_t>(spring.j);
    const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
    const double length = std::sqrt(dot3(d, d)), inverse_length = length > 0 ? 1 / length : 0;
    const double axial_stiffness = s * s * spring.stiffness;
    double transverse = axial_stiffness;
    if (spring.rest_length > 0)
      transverse = length > spring.rest_length
                       ? axial_stiffness * (1 - spring.rest_length * inverse_length)
                       : 0;
    SpringStiffness stiffness{
        spring.i, spring.j, transverse, axial_stiffness - transverse + s * spring.damping, {}};
    for (int k = 0; k < 3; ++k) stiffness.direction[k] = d[k] * inverse_length;
    for (const std::int32_t n : {spring.i, spring.j}) {
      double* block = blocks_.data() + 9 * static_cast<std::size_t>(n);
      for (int row = 0; row < 3; ++row) {
        for (int k = 0; k < 3; ++k)
          block[3 * row + k] += stiffness.axial * stiffness.direction[row] * stiffness.direction[k];
        block[4 * row] += transverse;
      }
    }
    springs_.push_back(stiffness);
  }

  // Inverts a symmetric positive 3 by 3 matrix in place.
  static void invert(double* m) {
    const double a = m[0], b = m[1], c = m[2], d = m[4], e = m[5], f = m[8];
    const double A = d * f - e * e, B = c * e - b * f, C = b * e - c * d;
    const double inverse_determinant = 1 / (a * A + b * B + c * C);
    m[0] = A * inverse_determinant;
    m[1] = m[3] = B * inverse_determinant;
    m[2] = m[6] = C * inverse_determinant;
    m[4] = (a * f - c * c) * inverse_determinant;
    m[5] = m[7] = (b * c - a * e) * inverse_determinant;
    m[8] = (a * d - b * b) * inverse_determinant;
  }

  // Multiplies the matrix by a vector.
  void multiply(const std::vector<double>& in, std::vector<double>& out) const {
    for (std::size_t k = 0; k < run_.size; ++k) out[k] = diagonal_[k / PARTICLE_STRIDE] * in[k];
    for (const SpringStiffness& spring : springs_) {
      const double* a = in.data() + PARTICLE_STRIDE * static_cast<std::size_t>(spring.i);
      const double* b = in.data() + PARTICLE_STRIDE * static_cast<std::size_t>(spring.j);
      const double e[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
      const double axial = spring.axial * dot3(spring.direction, e);
      double* f = out.data() + PARTICLE_STRIDE * static_cast<std::size_t>(spring.i);
      double* g = out.data() + PARTICLE_STRIDE * static_cast<std::size_t>(spring.j);
      for (int k = 0; k < 3; ++k) {
        const double force = spring.transverse * e[k] + axial * spring.direction[k];
        f[k] += force;
        g[k] -= force;
      }
    }
    zero_pinned(out);
  }

  void zero_pinned(std::vector<double>& values) const {
    for (const std::int32_t n : run_.network.pinned_particles)
      std::fill_n(values.data() + PARTICLE_STRIDE * static_cast<std::size_t>(n), 3, 0.0);
  }

  // Multiplies by an approximate inverse of the matrix; an exact one for chains.
  void precondition(const std::vector<double>& in, std::vector<double>& out) {
    if (is_chain()) return chain_.solve(in, out, PARTICLE_STRIDE);
    for (std::size_t n = 0; n < run_.network.particle_count(); ++n) {
      const double *block = blocks_.data() + 9 * n, *a = in.data() + PARTICLE_STRIDE * n;
      for (std::size_t k = 0; k < 3; ++k) out[PARTICLE_STRIDE * n + k] = dot3(block + 3 * k, a);
    }
  }

  static double dot_product(const std::vector<double>& a, const std::vector<double>& b) {
    double sum = 0;
    for (std::size_t k = 0; k < a.size(); ++k) sum += a[k] * b[k];
    return sum;
  }

  // Computes the correction that removes the residual; returns its largest component.
  double solve_correction() {
    std::fill(correction_.begin(), correction_.end(), 0.0);
    r_ = residual_;
    precondition(r_, z_);
    p_ = z_;
    double squared_residual = dot_product(r_, z_);
    const double tolerance = CG_TOLERANCE * CG_TOLERANCE * squared_residual;
    for (int i = 0; i < MAX_MATRIX_PRODUCTS && squared_residual > tolerance; ++i) {
      multiply(p_, q_);
      const double fraction = squared_residual / dot_product(p_, q_);
      for (std::size_t k = 0; k < run_.size; ++k) {
        correction_[k] += fraction * p_[k];
        r_[k] -= fraction * q_[k];
      }
      precondition(r_, z_);
      const double next_squared = dot_product(r_, z_), ratio = next_squared / squared_residual;
      squared_residual = next_squared;
      for (std::size_t k = 0; k < run_.size; ++k) p_[k] = z_[k] + ratio * p_[k];
    }
    double largest = 0;
    for (const double value : correction_)
      largest = std::abs(value) <= largest ? largest : std::abs(value);
    return largest;
  }

  SpringRun& run_;
  double tolerance_;
  std::vector<SpringStiffness> springs_;
  std::size_t bandwidth_ = 0;  // largest index distance of spring ends
  ChainFactor chain_;
  std::vector<double> residual_, correction_, r_, z_, p_, q_, blocks_, diagonal_, trial_x_,
      trial_v_;
};

// Positions and velocities.
struct State {
  std::vector<double> x, v;
};

// Impulses on the carriers of pinned particles, with their moments about the origin: of the last
// step, and summed over all steps. They are summed in the same way as steps sum accelerations, so
// that momentum is conserved.
class PinImpulses {
 public:
  PinImpulses(const SpringRun& run, const std::optional<In<double, 2>>& last_impulses)
      : is_enabled(last_impulses), run_(run), pinned_particles_(run.network.pinned_particles) {
    if (!is_enabled) return;
    pin_indices_.resize(run.network.particle_count(), -1);
    for (std::size_t p = 0; p < pinned_particles_.size(); ++p)
      pin_indices_[static_cast<std::size_t>(pinned_particles_[p])] = static_cast<std::int32_t>(p);
    check::numbers("last_pin_impulses", *last_impulses, {pinned_particles_.size(), IMPULSE_SIZE});
    last_impulses_.assign(last_impulses->data(), last_impulses->data() + last_impulses->size());
    total_impulses_.resize(last_impulses_.size());
    forces_.resize(run.size);
  }

  // Adds a step of h [s], which continues a fraction of the last impulse.
  void add(double h, double fraction) {
    if (!is_enabled) return;
    const double *x = run_.x.data(), *v = run_.v.data();
    std::fill(forces_.begin(), forces_.end(), 0.0);
    for (const Spring& spring : run_.spring_set().springs)
      if (pin_indices_[static_cast<std::size_t>(spring.i)] >= 0 ||
          pin_indices_[static_cast<std::size_t>(spring.j)] >= 0)
        add_spring_force(spring, x, v);
    run_.network.add_air_forces(run_.wind, x, v, forces_.data());
    for (std::size_t p = 0; p < pinned_particles_.size(); ++p) {
      const std::size_t row = PARTICLE_STRIDE * static_cast<std::size_t>(pinned_particles_[p]);
      const double *r = x + row, *f = forces_.data() + row;
      const double force_and_moment[IMPULSE_SIZE] = {f[0],
                                                     f[1],
                                                     f[2],
                                                     r[1] * f[2] - r[2] * f[1],
                                                     r[2] * f[0] - r[0] * f[2],
                                                     r[0] * f[1] - r[1] * f[0]};
      for (std::size_t k = 0; k < IMPULSE_SIZE; ++k) {
        double& impulse = last_impulses_[IMPULSE_SIZE * p + k];
        impulse = fraction * impulse + h * force_and_moment[k];
        total_impulses_[IMPULSE_SIZE * p + k] += impulse;
      }
    }
  }

  // The total and the last impulses.
  using Snapshot = std::pair<std::vector<double>, std::vector<double>>;
  Snapshot snapshot() const { return {total_impulses_, last_impulses_}; }
  void restore(const Snapshot& snapshot) { std::tie(total_impulses_, last_impulses_) = snapshot; }

  // Returns the total and then the last impulses (2, H, 6).
  Out<double, 3> arrays() const {
    Out<double, 3> result(2, total_impulses_.size() / IMPULSE_SIZE, IMPULSE_SIZE);
    std::copy(total_impulses_.begin(), total_impulses_.end(), result.get());
    std::copy(last_impulses_.begin(), last_impulses_.end(), result.get() + total_impulses_.size());
    return result;
  }

  const bool is_enabled;

 private:
  static constexpr std::size_t IMPULSE_SIZE = 6;

  void add_spring_force(const Spring& spring, const double* x, const double* v) {
    const std::size_t i = PARTICLE_STRIDE * static_cast<std::size_t>(spring.i);
    const std::size_t j = PARTICLE_STRIDE * static_cast<std::size_t>(spring.j);
    double d[3], e[3];
    for (std::size_t k = 0; k < 3; ++k) {
      d[k] = x[j + k] - x[i + k];
      e[k] = v[j + k] - v[i + k];
    }
    const double length = std::sqrt(dot3(d, d));
    if (!(length > 0)) return;
    const double force =
        (spring.stiffness * (length - spring.rest_length) + spring.damping * dot3(d, e) / length) /
        length;
    for (std::size_t k = 0; k < 3; ++k) {
      forces_[i + k] += force * d[k];
      forces_[j + k] -= force * d[k];
    }
  }

  const SpringRun& run_;
  const std::vector<std::int32_t>& pinned_particles_;
  std::vector<std::int32_t> pin_indices_;  // index of each particle among the pinned ones, or -1
  std::vector<double> last_impulses_, total_impulses_, forces_;
};

// Solves intervals of time by implicit steps.
class IntervalSolver {
 public:
  IntervalSolver(SpringRun& run, SpringContacts& contacts, double tolerance, bool uses_bdf2,
                 PinImpulses& pin_impulses)
      : run_(run),
        contacts_(contacts),
        solver_(run, tolerance),
        uses_bdf2_(uses_bdf2),
        pin_impulses_(pin_impulses) {}

  // Solves an interval in a number of steps; returns whether all of them converged.
  bool solve_interval(std::int64_t index, double start, double interval_duration, int substeps) {
    const double h = interval_duration / substeps;
    contacts_.begin_interval(index, substeps, h);
    for (int step = 0; step < substeps; ++step) {
      const double t = start + (step + 1) * h;
      run_.sample_surroundings(t, h);
      current = {run_.x, run_.v};
      double s = h;
      bx_ = current.x;
      bv_ = current.v;
      if (uses_bdf2_ && has_previous) {
        s = h * (2.0 / 3.0);
        for (std::size_t k = 0; k < run_.size; ++k) {
          bx_[k] = (4 * current.x[k] - previous.x[k]) / 3;
          bv_[k] = (4 * current.v[k] - previous.v[k]) / 3;
          run_.v[k] = 2 * current.v[k] - previous.v[k];
        }
      }
      if (!solver_.solve(bx_, bv_, s, t)) return false;
      pin_impulses_.add(s, uses_bdf2_ && has_previous ? 1.0 / 3.0 : 0.0);
      run_.network.set_pinned(t, h, current.x.data(), run_.x.data(), run_.v.data());
      previous = current;
      // The two-step method needs a smooth history.
      const bool has_contacts = contacts_.resolve(step, current.x, run_.x, &run_.v);
      has_previous = uses_bdf2_ && !has_contacts;
      ++steps;
    }
    return true;
  }

  std::int64_t corrections() const { return solver_.corrections; }

  State previous, current;
  bool has_previous = false;
  std::int64_t steps = 0;

 private:
  SpringRun& run_;
  SpringContacts& contacts_;
  ImplicitSolver solver_;
  bool uses_bdf2_;
  PinImpulses& pin_impulses_;
  std::vector<double> bx_, bv_;
};

}  // namespace

SpringSolveResult solve_springs(const SpringNetwork& network, In<double, 3> state,
                                std::optional<In<double, 3>> earlier_state,
                                In<std::uint8_t, 1> is_torn, double origin,
                                std::int64_t first_interval, double interval_duration,
                                std::int64_t interval_count, int substeps, bool uses_bdf2,
                                double tolerance, const std::optional<SpringColliders>& colliders,
                                std::optional<In<double, 2>> last_pin_impulses) {
  const IntervalGrid grid{origin, first_interval, interval_duration, interval_count};
  check::between("substeps", substeps, 1, static_cast<int>(MAX_SUBSTEPS >> MAX_DOUBLINGS));
  check_intervals(grid, substeps << MAX_DOUBLINGS);
  check::positive("tolerance", tolerance);
  check::finite("state", state);
  SpringRun run = build_run(network, state, is_torn);
  if (earlier_state) {
    check::numbers("earlier_state", *earlier_state, {2, network.particle_count(), 3});
  }
  SpringContacts contacts(colliders, network, interval_count);
  PinImpulses pin_impulses(run, last_pin_impulses);
  IntervalSolver solver(run, contacts, tolerance, uses_bdf2, pin_impulses);
  solver.previous = {run.x, run.v};
  std::int64_t unsolved_count = 0;
  {
    if (earlier_state && uses_bdf2) {
      const std::size_t row = 3 * network.particle_count();
      const SpringRun previous_run(network, earlier_state->data(), earlier_state->data() + row,
                                   is_torn.data());
      solver.previous = {previous_run.x, previous_run.v};
      solver.has_previous = true;
    }
    for (std::int64_t i = 0; i < interval_count && !unsolved_count; ++i) {
      const State start{run.x, run.v};
      const PinImpulses::Snapshot pin_snapshot = pin_impulses.snapshot();
      if (!solver.solve_interval(i, grid.start(i), interval_duration, substeps)) {
        // The equations of shorter steps are easier.
        bool is_solved = false;
        for (int doubling = 1; doubling <= MAX_DOUBLINGS && !is_solved; ++doubling) {
          run.x = start.x;
          run.v = start.v;
          pin_impulses.restore(pin_snapshot);
          solver.has_previous = false;
          is_solved =
              solver.solve_interval(i, grid.start(i), interval_duration, substeps << doubling);
          solver.has_previous = false;
        }
        unsolved_count += !is_solved;
        if (!is_solved) {
          run.x = start.x;
          run.v = start.v;
        }
      }
      run.tear();
    }
  }
  SpringRun previous_run = run;
  previous_run.x = solver.previous.x;
  previous_run.v = solver.previous.v;
  return {
      copy_state(run),     copy_state(previous_run), solver.has_previous, copy_torn(run),
      solver.steps,        solver.corrections(),     unsolved_count,      contacts.unresolved_count,
      contacts.impulses(), pin_impulses.arrays()};
}

}  // namespace animtool
