// Implicit Euler and BDF2 steps of networks of springs: Newton's method, whose equations
// are solved by conjugate gradients without a matrix; those of chains directly.
//
// D. Baraff, A. Witkin, Large Steps in Cloth Simulation, 1998; K.-J. Choi, H.-S. Ko,
// Stable but Responsive Cloth, 2002 (the negative transverse stiffness of compressed springs is
// left out, so that the matrix stays positive definite).
#include <algorithm>
#include <tuple>
#include <utility>

#include "base/checks.h"
#include "springs/chain.h"
#include "springs/steps.h"

namespace animtool {

namespace {

constexpr int MAX_CORRECTIONS = 40, MAX_HALVINGS = 8, MAX_SPLITS = 6;
constexpr int MAX_PRODUCTS = 400;
// Relative residual at which conjugate gradients end: the next correction removes it.
constexpr double CG_TOLERANCE = 1e-3;

// The stiffness of a spring in a step: `across` in all directions, plus `along` in its own.
struct Link {
  std::int32_t i, j;
  double across, along, u[3];
};

class Implicit {
 public:
  Implicit(SpringRun& run, double tolerance)
      : run_(run),
        tolerance_(tolerance),
        residual_(run.size),
        step_(run.size),
        r_(run.size),
        z_(run.size),
        p_(run.size),
        q_(run.size),
        blocks_(9 * run.network.particles()),
        trial_x_(run.size),
        trial_v_(run.size) {}

  // Solves m (bv - v) + s F(bx + s v, v) = 0 for v, from a guess in run.v; returns success.
  bool solve(const std::vector<double>& bx, const std::vector<double>& bv, double s, double t) {
    set_pinned(bx, s, t, run_.v);
    move(bx, s, run_.v, run_.x);
    double size = measure(bv, s, run_.x, run_.v);
    for (int i = 0; i < MAX_CORRECTIONS; ++i) {
      ++corrections;
      assemble_stiffness(s);
      const double largest = correct();
      double fraction = 1, after = 0;
      for (int halving = 0; halving < MAX_HALVINGS; ++halving, fraction /= 2) {
        for (std::size_t k = 0; k < run_.size; ++k) trial_v_[k] = run_.v[k] + fraction * step_[k];
        move(bx, s, trial_v_, trial_x_);
        after = measure(bv, s, trial_x_, trial_v_);
        if (after <= 4 * size || size == 0) break;
      }
      run_.v.swap(trial_v_);
      run_.x.swap(trial_x_);
      size = after;
      if (!(largest < HUGE_VAL)) return false;
      if (fraction == 1 && largest * s <= tolerance_) return true;
    }
    return false;
  }

  std::int64_t corrections = 0;

 private:
  // Pinned particles follow their track.
  void set_pinned(const std::vector<double>& bx, double s, double t, std::vector<double>& v) {
    run_.network.set_pinned(t, s, bx.data(), trial_x_.data(), v.data());
  }

  void move(const std::vector<double>& bx, double s, const std::vector<double>& v,
            std::vector<double>& x) const {
    for (std::size_t k = 0; k < run_.size; ++k) x[k] = bx[k] + s * v[k];
  }

  // Computes the residual, and returns its square over the masses.
  double measure(const std::vector<double>& bv, double s, const std::vector<double>& x,
                 const std::vector<double>& v) {
    run_.accelerate(x.data(), v.data(), residual_.data());
    double sum = 0;
    for (std::size_t n = 0; n < run_.network.particles(); ++n) {
      const double inverse = run_.network.inverse_masses[n];
      for (std::size_t k = ROW * n; k < ROW * n + 3; ++k) {
        if (inverse == 0) {
          residual_[k] = 0;
          continue;
        }
        const double off = bv[k] - v[k] + s * residual_[k];
        residual_[k] = off / inverse;
        sum += off * residual_[k];
      }
    }
    return sum;
  }

  void assemble_stiffness(double s) {
    const SpringNetwork& network = run_.network;
    links_.clear();
    for (std::size_t n = 0; n < network.particles(); ++n) {
      double* block = blocks_.data() + 9 * n;
      std::fill_n(block, 9, 0.0);
      const double inverse = network.inverse_masses[n];
      const double diagonal = inverse > 0 ? (1 + s * network.drags[n]) / inverse : 1;
      for (int k = 0; k < 3; ++k) block[4 * k] = diagonal;
    }
    for (std::size_t a = 0; a < network.anchors.size(); ++a) {
      double* block = blocks_.data() + 9 * static_cast<std::size_t>(network.anchors[a]);
      for (int k = 0; k < 3; ++k)
        block[4 * k] += s * s * network.anchor_stiffness[a] + s * network.anchor_damping[a];
    }
    add_air_damping(s);
    diagonal_.resize(network.particles());
    for (std::size_t n = 0; n < network.particles(); ++n) diagonal_[n] = blocks_[9 * n];
    for (const Spring& spring : run_.lines().springs) add_spring(spring, s);
    reach_ = 0;
    for (const Link& link : links_)
      reach_ = std::max(reach_, static_cast<std::size_t>(std::abs(link.i - link.j)));
    if (is_chain()) return factor_chain();
    for (std::size_t n = 0; n < network.particles(); ++n) invert(blocks_.data() + 9 * n);
  }

  bool is_chain() const { return reach_ <= WIDEST_CHAIN; }

  void factor_chain() {
    const SpringNetwork& network = run_.network;
    chain_.begin(network.particles(), reach_);
    for (std::size_t n = 0; n < network.particles(); ++n)
      for (std::size_t row = 0; row < 3; ++row)
        for (std::size_t c = 0; c < 3; ++c)
          chain_.add(3 * n + row, 3 * n + c, blocks_[9 * n + 3 * row + c]);
    for (const Link& link : links_) {
      const auto [low, high] = std::minmax(link.i, link.j);
      const std::size_t i = static_cast<std::size_t>(low), j = static_cast<std::size_t>(high);
      // Pinned particles do not move, so they couple nothing.
      if (network.inverse_masses[i] == 0 || network.inverse_masses[j] == 0) continue;
      for (std::size_t row = 0; row < 3; ++row)
        for (std::size_t c = 0; c < 3; ++c)
          chain_.add(3 * j + row, 3 * i + c,
                     -(link.along * link.u[row] * link.u[c] + (row == c ? link.across : 0)));
    }
    chain_.factor();
  }

  void add_air_damping(double s) {
    const SpringNetwork& network = run_.network;
    const double bound = std::abs(network.air_drag) + std::abs(network.air_lift);
    if (bound == 0) return;
    const double *x = run_.x.data(), *v = run_.v.data();
    for (std::size_t t = 0; t < network.triangles.size(); t += 3) {
      const std::int32_t* corners = network.triangles.data() + t;
      const std::size_t rows[3] = {ROW * static_cast<std::size_t>(corners[0]),
                                   ROW * static_cast<std::size_t>(corners[1]),
                                   ROW * static_cast<std::size_t>(corners[2])};
      double a[3], b[3], flow[3];
      for (std::size_t k = 0; k < 3; ++k) {
        a[k] = x[rows[1] + k] - x[rows[0] + k];
        b[k] = x[rows[2] + k] - x[rows[0] + k];
        flow[k] = run_.wind[k] - (v[rows[0] + k] + v[rows[1] + k] + v[rows[2] + k]) / 3;
      }
      const double n[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                           a[0] * b[1] - a[1] * b[0]};
      const double slows = s * 2 * bound * std::sqrt(dot3(flow, flow)) * std::sqrt(dot3(n, n)) / 6;
      for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 3; ++k)
          blocks_[9 * static_cast<std::size_t>(corners[c]) + 4 * static_cast<std::size_t>(k)] +=
              slows;
    }
  }

  void add_spring(const Spring& spring, double s) {
    const double* p = run_.x.data() + ROW * static_cast<std::size_t>(spring.i);
    const double* q = run_.x.data() + ROW * static_cast<std::size_t>(spring.j);
    const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
    const double length = std::sqrt(dot3(d, d)), inverse = length > 0 ? 1 / length : 0;
    const double k = s * s * spring.stiffness;
    double across = k;
    if (spring.rest > 0) across = length > spring.rest ? k * (1 - spring.rest * inverse) : 0;
    Link link{spring.i, spring.j, across, k - across + s * spring.damping, {}};
    for (int c = 0; c < 3; ++c) link.u[c] = d[c] * inverse;
    for (const std::int32_t n : {spring.i, spring.j}) {
      double* block = blocks_.data() + 9 * static_cast<std::size_t>(n);
      for (int row = 0; row < 3; ++row) {
        for (int c = 0; c < 3; ++c) block[3 * row + c] += link.along * link.u[row] * link.u[c];
        block[4 * row] += across;
      }
    }
    links_.push_back(link);
  }

  // Inverts a symmetric positive 3 by 3 matrix in place.
  static void invert(double* m) {
    const double a = m[0], b = m[1], c = m[2], d = m[4], e = m[5], f = m[8];
    const double A = d * f - e * e, B = c * e - b * f, C = b * e - c * d;
    const double over = 1 / (a * A + b * B + c * C);
    m[0] = A * over;
    m[1] = m[3] = B * over;
    m[2] = m[6] = C * over;
    m[4] = (a * f - c * c) * over;
    m[5] = m[7] = (b * c - a * e) * over;
    m[8] = (a * d - b * b) * over;
  }

  void multiply(const std::vector<double>& in, std::vector<double>& out) const {
    for (std::size_t k = 0; k < run_.size; ++k) out[k] = diagonal_[k / ROW] * in[k];
    for (const Link& link : links_) {
      const double* a = in.data() + ROW * static_cast<std::size_t>(link.i);
      const double* b = in.data() + ROW * static_cast<std::size_t>(link.j);
      const double e[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
      const double along = link.along * dot3(link.u, e);
      double* f = out.data() + ROW * static_cast<std::size_t>(link.i);
      double* g = out.data() + ROW * static_cast<std::size_t>(link.j);
      for (int k = 0; k < 3; ++k) {
        const double force = link.across * e[k] + along * link.u[k];
        f[k] += force;
        g[k] -= force;
      }
    }
    zero_pinned(out);
  }

  void zero_pinned(std::vector<double>& values) const {
    for (const std::int32_t n : run_.network.pinned)
      std::fill_n(values.data() + ROW * static_cast<std::size_t>(n), 3, 0.0);
  }

  void precondition(const std::vector<double>& in, std::vector<double>& out) {
    if (is_chain()) return chain_.solve(in, out, ROW);
    for (std::size_t n = 0; n < run_.network.particles(); ++n) {
      const double *block = blocks_.data() + 9 * n, *a = in.data() + ROW * n;
      for (std::size_t k = 0; k < 3; ++k) out[ROW * n + k] = dot3(block + 3 * k, a);
    }
  }

  static double product(const std::vector<double>& a, const std::vector<double>& b) {
    double sum = 0;
    for (std::size_t k = 0; k < a.size(); ++k) sum += a[k] * b[k];
    return sum;
  }

  // Computes the step that removes the residual, and returns its largest component.
  double correct() {
    std::fill(step_.begin(), step_.end(), 0.0);
    r_ = residual_;
    precondition(r_, z_);
    p_ = z_;
    double size = product(r_, z_);
    const double tolerance = CG_TOLERANCE * CG_TOLERANCE * size;
    for (int i = 0; i < MAX_PRODUCTS && size > tolerance; ++i) {
      multiply(p_, q_);
      const double fraction = size / product(p_, q_);
      for (std::size_t k = 0; k < run_.size; ++k) {
        step_[k] += fraction * p_[k];
        r_[k] -= fraction * q_[k];
      }
      precondition(r_, z_);
      const double next = product(r_, z_), ratio = next / size;
      size = next;
      for (std::size_t k = 0; k < run_.size; ++k) p_[k] = z_[k] + ratio * p_[k];
    }
    double largest = 0;
    for (const double value : step_)
      largest = std::abs(value) <= largest ? largest : std::abs(value);
    return largest;
  }

  SpringRun& run_;
  double tolerance_;
  std::vector<Link> links_;
  std::size_t reach_ = 0;  // largest index distance of spring ends
  ChainFactor chain_;
  std::vector<double> residual_, step_, r_, z_, p_, q_, blocks_, diagonal_, trial_x_, trial_v_;
};

// Positions and velocities.
struct Pair {
  std::vector<double> x, v;
};

// Impulses on the carriers of pinned particles, with their moments about the origin: of the last
// step, and of all. They are summed as steps sum accelerations, so that momentum is conserved.
class PinImpulses {
 public:
  PinImpulses(const SpringRun& run, const std::optional<In<double, 2>>& last)
      : enabled(last), run_(run), pinned_(run.network.pinned) {
    if (!enabled) return;
    pin_of_.resize(run.network.particles(), -1);
    for (std::size_t p = 0; p < pinned_.size(); ++p)
      pin_of_[static_cast<std::size_t>(pinned_[p])] = static_cast<std::int32_t>(p);
    check::numbers("pulls", *last, {pinned_.size(), WIDTH});
    last_.assign(last->data(), last->data() + last->size());
    sum_.resize(last_.size());
    forces_.resize(run.size);
  }

  // Adds a step of h [s], which continues from a fraction of the last impulse.
  void add(double h, double fraction) {
    if (!enabled) return;
    const double *x = run_.x.data(), *v = run_.v.data();
    std::fill(forces_.begin(), forces_.end(), 0.0);
    for (const Spring& spring : run_.lines().springs)
      if (pin_of_[static_cast<std::size_t>(spring.i)] >= 0 ||
          pin_of_[static_cast<std::size_t>(spring.j)] >= 0)
        pull(spring, x, v);
    run_.network.add_air_forces(run_.wind, x, v, forces_.data());
    for (std::size_t p = 0; p < pinned_.size(); ++p) {
      const std::size_t at = ROW * static_cast<std::size_t>(pinned_[p]);
      const double *r = x + at, *f = forces_.data() + at;
      const double now[WIDTH] = {f[0],
                                 f[1],
                                 f[2],
                                 r[1] * f[2] - r[2] * f[1],
                                 r[2] * f[0] - r[0] * f[2],
                                 r[0] * f[1] - r[1] * f[0]};
      for (std::size_t k = 0; k < WIDTH; ++k) {
        double& impulse = last_[WIDTH * p + k];
        impulse = fraction * impulse + h * now[k];
        sum_[WIDTH * p + k] += impulse;
      }
    }
  }

  // The sum, and the last.
  using Sums = std::pair<std::vector<double>, std::vector<double>>;
  Sums sums() const { return {sum_, last_}; }
  void restore(const Sums& begun) { std::tie(sum_, last_) = begun; }

  // (2, H, 6): the sum, then the last.
  Out<double, 3> arrays() const {
    Out<double, 3> result(2, sum_.size() / WIDTH, WIDTH);
    std::copy(sum_.begin(), sum_.end(), result.get());
    std::copy(last_.begin(), last_.end(), result.get() + sum_.size());
    return result;
  }

  const bool enabled;

 private:
  static constexpr std::size_t WIDTH = 6;

  void pull(const Spring& spring, const double* x, const double* v) {
    const std::size_t i = ROW * static_cast<std::size_t>(spring.i);
    const std::size_t j = ROW * static_cast<std::size_t>(spring.j);
    double d[3], e[3];
    for (std::size_t k = 0; k < 3; ++k) {
      d[k] = x[j + k] - x[i + k];
      e[k] = v[j + k] - v[i + k];
    }
    const double length = std::sqrt(dot3(d, d));
    if (!(length > 0)) return;
    const double force =
        (spring.stiffness * (length - spring.rest) + spring.damping * dot3(d, e) / length) / length;
    for (std::size_t k = 0; k < 3; ++k) {
      forces_[i + k] += force * d[k];
      forces_[j + k] -= force * d[k];
    }
  }

  const SpringRun& run_;
  const std::vector<std::int32_t>& pinned_;
  std::vector<std::int32_t> pin_of_;  // index of each particle among the pinned ones, or -1
  std::vector<double> last_, sum_, forces_;
};

class CellSolver {
 public:
  CellSolver(SpringRun& run, SpringContacts& contacts, double tolerance, bool two_steps,
             PinImpulses& pulls)
      : run_(run),
        contacts_(contacts),
        implicit_(run, tolerance),
        two_steps_(two_steps),
        pulls_(pulls) {}

  // Solves a cell in a number of steps; returns success.
  bool solve_cell(std::int64_t index, double start, double cell, int substeps) {
    const double h = cell / substeps;
    contacts_.begin_cell(index, substeps, h);
    for (int j = 0; j < substeps; ++j) {
      const double t = start + (j + 1) * h;
      run_.sample_surroundings(t, h);
      now = {run_.x, run_.v};
      double s = h;
      bx_ = now.x;
      bv_ = now.v;
      if (two_steps_ && known) {
        s = h * (2.0 / 3.0);
        for (std::size_t k = 0; k < run_.size; ++k) {
          bx_[k] = (4 * now.x[k] - before.x[k]) / 3;
          bv_[k] = (4 * now.v[k] - before.v[k]) / 3;
          run_.v[k] = 2 * now.v[k] - before.v[k];
        }
      }
      if (!implicit_.solve(bx_, bv_, s, t)) return false;
      pulls_.add(s, two_steps_ && known ? 1.0 / 3.0 : 0.0);
      run_.network.set_pinned(t, h, now.x.data(), run_.x.data(), run_.v.data());
      before = now;
      // The two-step method needs a smooth history.
      const bool met = contacts_.resolve(j, now.x, run_.x, &run_.v);
      known = two_steps_ && !met;
      ++steps;
    }
    return true;
  }

  std::int64_t corrections() const { return implicit_.corrections; }

  Pair before, now;
  bool known = false;
  std::int64_t steps = 0;

 private:
  SpringRun& run_;
  SpringContacts& contacts_;
  Implicit implicit_;
  bool two_steps_;
  PinImpulses& pulls_;
  std::vector<double> bx_, bv_;
};

}  // namespace

SpringsSolved solve_springs(const SpringNetwork& network, In<double, 3> state,
                            std::optional<In<double, 3>> earlier, In<std::uint8_t, 1> torn,
                            double origin, std::int64_t first, double cell, std::int64_t cells,
                            int substeps, bool two_steps, double tolerance,
                            const std::optional<SpringColliders>& colliders,
                            std::optional<In<double, 2>> supplied) {
  const Cells grid{origin, first, cell, cells};
  check::between("substeps", substeps, 1, static_cast<int>(MAX_SUBSTEPS >> MAX_SPLITS));
  check_cells(grid, substeps << MAX_SPLITS);
  check::positive("tolerance", tolerance);
  check::finite("state", state);
  SpringRun run = begin_springs(network, state, torn);
  if (earlier) {
    check::numbers("before", *earlier, {2, network.particles(), 3});
  }
  SpringContacts contacts(colliders, network, cells);
  PinImpulses pulls(run, supplied);
  CellSolver solver(run, contacts, tolerance, two_steps, pulls);
  solver.before = {run.x, run.v};
  std::int64_t unsolved = 0;
  {
    if (earlier && two_steps) {
      const std::size_t row = 3 * network.particles();
      const SpringRun back(network, earlier->data(), earlier->data() + row, torn.data());
      solver.before = {back.x, back.v};
      solver.known = true;
    }
    for (std::int64_t i = 0; i < cells && !unsolved; ++i) {
      const Pair start{run.x, run.v};
      const PinImpulses::Sums begun = pulls.sums();
      if (!solver.solve_cell(i, grid.start(i), cell, substeps)) {
        // The equations of shorter steps are easier.
        bool is_solved = false;
        for (int split = 1; split <= MAX_SPLITS && !is_solved; ++split) {
          run.x = start.x;
          run.v = start.v;
          pulls.restore(begun);
          solver.known = false;
          is_solved = solver.solve_cell(i, grid.start(i), cell, substeps << split);
          solver.known = false;
        }
        unsolved += !is_solved;
        if (!is_solved) {
          run.x = start.x;
          run.v = start.v;
        }
      }
      run.tear();
    }
  }
  SpringRun back = run;
  back.x = solver.before.x;
  back.v = solver.before.v;
  return {ended_state(run),    ended_state(back),    solver.known, ended_torn(run),
          solver.steps,        solver.corrections(), unsolved,     contacts.unresolved,
          contacts.impulses(), pulls.arrays()};
}

}  // namespace animtool
