// Extended position based dynamics in small steps: each spring once per step, in order.
//
// M. Macklin, M. Müller, N. Chentanez, XPBD, 2016; M. Macklin et al., Small Steps in
// Physics Simulation, 2019. Strain limits: X. Provot, Deformation Constraints in a Mass-Spring
// Model to Describe Rigid Cloth Behavior, 1995, 4. Speeds along edges: H. C. Andersen, RATTLE,
// 1983; R. Goldenthal et al., Efficient Simulation of Inextensible Cloth, 2007.
#include <algorithm>
#include <limits>

#include "base/checks.h"
#include "springs/loops.h"
#include "springs/self.h"
#include "springs/steps.h"

namespace animtool {

namespace {

// Calm cells after which half as many steps are tried.
constexpr int RELAXED_CELLS = 120;
// Strain, relative to the limit, below which a cell is calm.
constexpr double RELAXED_FRACTION = 0.125;
// Ratio of strain to its part beyond compliance above which it counts as compliance.
constexpr double COMPLIANT = 2;
// Springs with a compliance below this fraction of the correction count as stiff [1].
constexpr double RIGID = 0.1;
// Passes of strain limiting in a step.
constexpr int LIMIT_PASSES = 4;
// Strain that contacts may add, over the limit, and passes of reducing it.
constexpr double LAST_LIMIT = 1.4;
constexpr int LAST_PASSES = 2;
// Strain over the limit above which a cell is repeated in shorter steps, and ratio of strains
// below which these help.
constexpr double BEYOND_LIMIT = 2, MIN_IMPROVEMENT = 0.7;

// Correction factors of a spring in a step of h: of its elongation, and of the change of it.
struct Compliance {
  double length, change;
};

Compliance compliance_of(double stiffness, double damping, double weight, double h) {
  const double k = stiffness * h * h, c = damping * h;
  const double full = (k + c) * weight + 1;
  return {k / full, c / full};
}

class Projection {
 public:
  Projection(SpringRun& run, double cell, double limit, SpringContacts& contacts,
             SelfContacts& self)
      : run_(run),
        contacts_(contacts),
        self_(self),
        cell_(cell),
        limit_(limit),
        before_(run.size) {}

  // Advances a cell in a number of steps; returns the largest strain of a spring that is not mostly
  // due to its own compliance under load.
  double advance_cell(std::int64_t index, double start, int substeps) {
    prepare(substeps);
    const double h = cell_ / substeps;
    contacts_.begin_cell(index, substeps, h);
    self_.begin_cell(index, run_.x);
    for (int j = 0; j < substeps; ++j) {
      const double t = start + j * h;
      run_.sample_surroundings(t + h, h);
      if (limit_ > 0) start_ = run_.x;
      predict(h);
      run_.network.set_pinned(t + h, h, before_.data(), run_.x.data(), run_.v.data());
      project(j + 1 < substeps ? nullptr : excess_.data());
      pull_anchors();
      limit_strains(limit_);
      self_.separate(h, before_, run_.x);
      resolve(j, h);
      self_.record_crossings(before_, run_.x);
      const double rate = 1 / h;
      for (std::size_t k = 0; k < run_.size; ++k) run_.v[k] = (run_.x[k] - before_[k]) * rate;
      damp_edge_speeds();
    }
    return largest_strain();
  }

  void forget() { prepared_ = 0; }

 private:
  void prepare(int substeps) {
    if (prepared_ == substeps) return;
    prepared_ = substeps;
    const double h = cell_ / substeps;
    const auto& masses = run_.network.inverse_masses;
    lengths_.clear();
    changes_.clear();
    weights_.clear();
    for (const Spring& spring : run_.lines().springs) {
      weights_.push_back(masses[static_cast<std::size_t>(spring.i)]);
      weights_.push_back(masses[static_cast<std::size_t>(spring.j)]);
      const double both = *(weights_.end() - 2) + weights_.back();
      const Compliance compliance = compliance_of(spring.stiffness, spring.damping, both, h);
      lengths_.push_back(compliance.length);
      changes_.push_back(compliance.change);
    }
    anchor_compliances_.clear();
    for (std::size_t a = 0; a < run_.network.anchors.size(); ++a)
      anchor_compliances_.push_back(
          compliance_of(run_.network.anchor_stiffness[a], run_.network.anchor_damping[a],
                        masses[static_cast<std::size_t>(run_.network.anchors[a])], h));
    excess_.assign(run_.lines().springs.size(), 0.0);
    collect_limited();
  }

  // Collects stiff springs, with the weights of their ends.
  void collect_limited() {
    limited_.clear();
    if (!(limit_ > 0)) return;
    for (std::size_t s = 0; s < run_.lines().springs.size(); ++s) {
      const Spring& spring = run_.lines().springs[s];
      const double first = weights_[2 * s], last = weights_[2 * s + 1], both = first + last;
      if (!(spring.rest > 0) || !(lengths_[s] * both > 1 - RIGID)) continue;
      limited_.push_back({ROW * static_cast<std::size_t>(spring.i),
                          ROW * static_cast<std::size_t>(spring.j), spring.rest, first / both,
                          last / both});
    }
  }

  void predict(double h) {
    const SpringNetwork& network = run_.network;
    before_ = run_.x;
    const bool windy =
        (network.air_drag != 0 || network.air_lift != 0) && !network.triangles.empty();
    if (windy) {
      forces_.assign(run_.size, 0.0);
      network.add_air_forces(run_.wind, run_.x.data(), run_.v.data(), forces_.data());
    }
    const double fall[3] = {h * network.gravity[0], h * network.gravity[1], h * network.gravity[2]};
    double *x = run_.x.data(), *v = run_.v.data();
    for (std::size_t n = 0; n < network.particles(); ++n) {
      const double inverse = network.inverse_masses[n];
      if (inverse == 0) continue;
      const double slowed = 1 / (1 + h * network.drags[n]);
      for (std::size_t k = 0; k < 3; ++k) {
        double speed = v[ROW * n + k] + fall[k];
        if (windy) speed += h * inverse * forces_[ROW * n + k];
        x[ROW * n + k] += h * (speed * slowed);
      }
    }
  }

  void project(double* excess) {
    const SpringLines& lines = run_.lines();
    const ComplianceColumns columns{lines.ends.data(), lines.rest.data(), lengths_.data(),
                                    changes_.data(), weights_.data()};
    spring_loops().project(columns, lines.runs.data(), lines.runs.size(), run_.x.data(),
                           before_.data(), excess);
  }

  // Resolves contacts with colliders and, if strain is limited, piercing and the strain that
  // contacts caused.
  void resolve(int step, double h) {
    contacts_.resolve(step, before_, run_.x, nullptr);
    if (!(limit_ > 0)) return;
    const auto resolve_contacts = [&] {
      contacts_.resolve(step, before_, run_.x, nullptr, &moved_);
    };
    moved_.assign(run_.network.particles(), 1);
    self_.prevent_piercing(h, start_, before_, run_.x, moved_, resolve_contacts);
    for (int pass = 0; pass < LAST_PASSES; ++pass) {
      std::fill(moved_.begin(), moved_.end(), 0);
      if (!limit_strains(LAST_LIMIT * limit_, &moved_)) return;
      resolve_contacts();
      self_.prevent_piercing(h, start_, before_, run_.x, moved_, resolve_contacts);
    }
  }

  void pull_anchors() {
    const SpringNetwork& network = run_.network;
    for (std::size_t a = 0; a < network.anchors.size(); ++a) {
      const std::size_t at = ROW * static_cast<std::size_t>(network.anchors[a]);
      const double inverse = network.inverse_masses[at / ROW];
      for (std::size_t k = 0; k < 3; ++k) {
        const double off = run_.points[3 * a + k] - run_.x[at + k];
        const double displacement = off - (run_.points_before[3 * a + k] - before_[at + k]);
        run_.x[at + k] += inverse * (anchor_compliances_[a].length * off +
                                     anchor_compliances_[a].change * displacement);
      }
    }
  }

  // Clamps the strain of stiff springs; both ends move, so that momentum is conserved. Returns
  // whether any moved; those are marked.
  bool limit_strains(double limit, std::vector<std::uint8_t>* marks = nullptr) {
    bool moved = false;
    for (int pass = 0; pass < LIMIT_PASSES; ++pass) {
      bool any = false;
      for (const LimitedEdge& one : limited_) {
        double *p = run_.x.data() + one.i, *q = run_.x.data() + one.j;
        const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
        const double square = dot3(d, d), low = one.rest * (1 - limit),
                     high = one.rest * (1 + limit);
        if (!(square > high * high || (square < low * low && square > 0))) continue;
        const double length = std::sqrt(square);
        const double by = (length - std::clamp(length, low, high)) / length;
        for (std::size_t k = 0; k < 3; ++k) {
          p[k] += one.first * by * d[k];
          q[k] -= one.last * by * d[k];
        }
        if (marks) (*marks)[one.i / ROW] = (*marks)[one.j / ROW] = 1;
        any = true;
      }
      if (!any) break;
      moved = true;
    }
    return moved;
  }

  // Removes the relative speed of ends along stiff edges, so that strain limiting adds no speed.
  void damp_edge_speeds() {
    for (const LimitedEdge& one : limited_) {
      const double *p = run_.x.data() + one.i, *q = run_.x.data() + one.j;
      double *u = run_.v.data() + one.i, *v = run_.v.data() + one.j;
      const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
      const double over[3] = {v[0] - u[0], v[1] - u[1], v[2] - u[2]};
      const double square = dot3(d, d);
      if (!(square > 0)) continue;
      const double by = dot3(d, over) / square;
      for (std::size_t k = 0; k < 3; ++k) {
        u[k] += one.first * by * d[k];
        v[k] -= one.last * by * d[k];
      }
    }
  }

  double largest_strain() const {
    double most = 0;
    for (std::size_t s = 0; s < run_.lines().springs.size(); ++s) {
      const Spring& spring = run_.lines().springs[s];
      if (!(spring.rest > 0) || !(spring.stiffness > 0)) continue;
      const double* p = run_.x.data() + ROW * static_cast<std::size_t>(spring.i);
      const double* q = run_.x.data() + ROW * static_cast<std::size_t>(spring.j);
      const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
      const double square = dot3(d, d), bound = spring.rest * (1 + most);
      if (square <= bound * bound) continue;
      const double beyond = std::sqrt(square) - spring.rest;
      const double compliance = std::max(0.0, excess_[s]);
      most = std::max(most, std::min(beyond, COMPLIANT * (beyond - compliance)) / spring.rest);
      if (square != square) return std::numeric_limits<double>::infinity();
    }
    return most;
  }

  SpringRun& run_;
  SpringContacts& contacts_;
  SelfContacts& self_;
  double cell_, limit_;
  int prepared_ = 0;
  struct LimitedEdge {
    std::size_t i, j;  // rows
    double rest, first, last;
  };
  std::vector<LimitedEdge> limited_;
  std::vector<double> start_;        // positions at the start of a step
  std::vector<std::uint8_t> moved_;  // particles moved since the last test
  std::vector<double> before_, forces_, lengths_, changes_, weights_;
  std::vector<double> excess_;  // elongation of springs right after their correction
  std::vector<Compliance> anchor_compliances_;
};

}  // namespace

SpringsProjected project_springs(const SpringNetwork& network, In<double, 3> state,
                                 In<std::uint8_t, 1> torn, double origin, std::int64_t first,
                                 double cell, std::int64_t cells, int substeps, int calm,
                                 int min_substeps, int max_substeps, double stretch,
                                 const std::optional<SpringColliders>& colliders,
                                 const SpringLayers* layers, In<std::int64_t, 2> crossed,
                                 double limit) {
  const Cells grid{origin, first, cell, cells};
  check::between("max_substeps", max_substeps, 1, static_cast<int>(MAX_SUBSTEPS));
  check::between("min_substeps", min_substeps, 1, static_cast<int>(MAX_SUBSTEPS));
  check_cells(grid, substeps);
  check_cells(grid, std::max(substeps, max_substeps));
  check::between("calm", calm, 0, std::numeric_limits<int>::max() / 2);
  if (!(stretch >= 0)) check::refuse("stretch", check::text(stretch) + " is not 0 or more");
  check::not_negative("limit", limit);
  check::finite("state", state);
  SpringRun run = begin_springs(network, state, torn);
  SpringContacts contacts(colliders, network, cells, limit > 0);
  SelfContacts self(layers, network, crossed, limit > 0);
  double largest_strain = 0;
  std::int64_t total_steps = 0;
  Projection projection(run, cell, limit, contacts, self);
  std::vector<double> x, v;
  for (std::int64_t i = 0; i < cells; ++i) {
    x = run.x;
    v = run.v;
    double strain = projection.advance_cell(i, grid.start(i), substeps);
    total_steps += substeps;
    const double bound = limit > 0 ? std::max(stretch, BEYOND_LIMIT * limit) : stretch;
    const auto has_new_crossings = [&] {
      return limit > 0 && self.crossings() > self.start_crossings();
    };
    bool improves = true;
    while ((!(strain <= bound) || has_new_crossings()) && substeps < max_substeps && improves) {
      substeps = std::min(2 * substeps, max_substeps);
      calm = 0;
      run.x = x;
      run.v = v;
      const double last = strain;
      strain = projection.advance_cell(i, grid.start(i), substeps);
      total_steps += substeps;
      // Shorter steps do not reduce the strain that contacts and pinned particles impose.
      if (limit > 0) improves = has_new_crossings() || strain <= MIN_IMPROVEMENT * last;
    }
    if (limit > 0 && strain <= bound && !has_new_crossings() && substeps > min_substeps)
      substeps = std::max(substeps / 2, min_substeps);
    largest_strain = std::max(largest_strain, strain);
    self.record_piercing();
    calm = strain <= RELAXED_FRACTION * stretch ? calm + 1 : 0;
    if (calm >= RELAXED_CELLS && substeps > min_substeps) {
      substeps = std::max(substeps / 2, min_substeps);
      calm = 0;
    }
    if (run.tear()) projection.forget();
  }
  return {ended_state(run), ended_torn(run), substeps,           calm,
          largest_strain,   total_steps,     contacts.touched,   contacts.unresolved,
          self.ended(),     self.piercing(), contacts.impulses()};
}

}  // namespace animtool
