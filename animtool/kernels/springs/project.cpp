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

// Number of consecutive calm intervals after which half as many steps are tried.
constexpr int CALM_INTERVAL_COUNT = 120;
// Strain, relative to the limit, below which an interval is calm.
constexpr double RELAXED_STRAIN_FRACTION = 0.125;
// A strain counts as compliance if it exceeds the strain beyond the compliance by this factor.
constexpr double COMPLIANT_STRAIN_RATIO = 2;
// Springs count as stiff if their compliance is below this fraction of the correction [1].
constexpr double STIFF_FRACTION = 0.1;
// Passes of strain limiting in a step.
constexpr int STRAIN_LIMIT_PASSES = 4;
// Strain that contacts may cause, over the limit; and passes that reduce it.
constexpr double CONTACT_STRAIN_FACTOR = 1.4;
constexpr int CONTACT_PASSES = 2;
// An interval is repeated in shorter steps if its strain exceeds the limit by this factor; shorter
// steps help if they reduce the strain to this ratio.
constexpr double MAX_STRAIN_EXCESS = 2, MAX_REDUCED_STRAIN_RATIO = 0.7;

// Correction factors of a spring in a step of h: of its elongation, and of the change of its
// elongation.
struct CorrectionFactors {
  double length, change;
};

CorrectionFactors correction_factors(double stiffness, double damping, double weight, double h) {
  const double k = stiffness * h * h, c = damping * h;
  const double divisor = (k + c) * weight + 1;
  return {k / divisor, c / divisor};
}

// Advances a run by projecting springs.
class Projection {
 public:
  Projection(SpringRun& run, double interval_duration, double strain_limit,
             SpringContacts& contacts, SelfContacts& self_contacts)
      : run_(run),
        contacts_(contacts),
        self_contacts_(self_contacts),
        interval_duration_(interval_duration),
        strain_limit_(strain_limit),
        positions_before_(run.size) {}

  // Advances an interval in a number of steps. Returns the largest strain of a spring that is not
  // mostly due to its own compliance under load.
  double advance_interval(std::int64_t index, double start, int substeps) {
    prepare(substeps);
    const double h = interval_duration_ / substeps;
    contacts_.begin_interval(index, substeps, h);
    self_contacts_.begin_interval(index, run_.x);
    for (int step = 0; step < substeps; ++step) {
      const double t = start + step * h;
      run_.sample_surroundings(t + h, h);
      if (strain_limit_ > 0) step_start_ = run_.x;
      predict(h);
      run_.network.set_pinned(t + h, h, positions_before_.data(), run_.x.data(), run_.v.data());
      project(step + 1 < substeps ? nullptr : elongations_.data());
      pull_anchors();
      limit_strains(strain_limit_);
      self_contacts_.separate(h, positions_before_, run_.x);
      resolve(step, h);
      self_contacts_.record_intersections(positions_before_, run_.x);
      const double inverse_h = 1 / h;
      for (std::size_t k = 0; k < run_.size; ++k)
        run_.v[k] = (run_.x[k] - positions_before_[k]) * inverse_h;
      damp_stiff_springs();
    }
    return max_strain();
  }

  // Recomputes the factors of springs before the next interval.
  void invalidate() { prepared_substeps_ = 0; }

 private:
  // Computes the factors of springs for a number of steps per interval.
  void prepare(int substeps) {
    if (prepared_substeps_ == substeps) return;
    prepared_substeps_ = substeps;
    const double h = interval_duration_ / substeps;
    const auto& inverse_masses = run_.network.inverse_masses;
    length_factors_.clear();
    change_factors_.clear();
    inverse_masses_.clear();
    for (const Spring& spring : run_.spring_set().springs) {
      inverse_masses_.push_back(inverse_masses[static_cast<std::size_t>(spring.i)]);
      inverse_masses_.push_back(inverse_masses[static_cast<std::size_t>(spring.j)]);
      const double inverse_mass_sum = *(inverse_masses_.end() - 2) + inverse_masses_.back();
      const CorrectionFactors factors =
          correction_factors(spring.stiffness, spring.damping, inverse_mass_sum, h);
      length_factors_.push_back(factors.length);
      change_factors_.push_back(factors.change);
    }
    anchor_factors_.clear();
    for (std::size_t a = 0; a < run_.network.anchors.size(); ++a)
      anchor_factors_.push_back(
          correction_factors(run_.network.anchor_stiffness[a], run_.network.anchor_damping[a],
                             inverse_masses[static_cast<std::size_t>(run_.network.anchors[a])], h));
    elongations_.assign(run_.spring_set().springs.size(), 0.0);
    collect_stiff_springs();
  }

  // Collects stiff springs, with the inverse masses of their ends.
  void collect_stiff_springs() {
    stiff_springs_.clear();
    if (!(strain_limit_ > 0)) return;
    for (std::size_t s = 0; s < run_.spring_set().springs.size(); ++s) {
      const Spring& spring = run_.spring_set().springs[s];
      const double first_inverse_mass = inverse_masses_[2 * s],
                   last_inverse_mass = inverse_masses_[2 * s + 1],
                   inverse_mass_sum = first_inverse_mass + last_inverse_mass;
      if (!(spring.rest_length > 0) ||
          !(length_factors_[s] * inverse_mass_sum > 1 - STIFF_FRACTION))
        continue;
      stiff_springs_.push_back({PARTICLE_STRIDE * static_cast<std::size_t>(spring.i),
                                PARTICLE_STRIDE * static_cast<std::size_t>(spring.j),
                                spring.rest_length, first_inverse_mass / inverse_mass_sum,
                                last_inverse_mass / inverse_mass_sum});
    }
  }

  // Moves particles by their velocities, gravity, air and drag.
  void predict(double h) {
    const SpringNetwork& network = run_.network;
    positions_before_ = run_.x;
    const bool has_air_forces =
        (network.air_drag != 0 || network.air_lift != 0) && !network.triangles.empty();
    if (has_air_forces) {
      forces_.assign(run_.size, 0.0);
      network.add_air_forces(run_.wind, run_.x.data(), run_.v.data(), forces_.data());
    }
    const double gravity_step[3] = {h * network.gravity[0], h * network.gravity[1],
                                    h * network.gravity[2]};
    double *x = run_.x.data(), *v = run_.v.data();
    for (std::size_t n = 0; n < network.particle_count(); ++n) {
      const double inverse_mass = network.inverse_masses[n];
      if (inverse_mass == 0) continue;
      const double drag_factor = 1 / (1 + h * network.drags[n]);
      for (std::size_t k = 0; k < 3; ++k) {
        double velocity = v[PARTICLE_STRIDE * n + k] + gravity_step[k];
        if (has_air_forces) velocity += h * inverse_mass * forces_[PARTICLE_STRIDE * n + k];
        x[PARTICLE_STRIDE * n + k] += h * (velocity * drag_factor);
      }
    }
  }

  // Corrects all springs once; stores their elongations unless null.
  void project(double* elongations) {
    const SpringSet& spring_set = run_.spring_set();
    const ComplianceColumns columns{spring_set.ends.data(), spring_set.rest_lengths.data(),
                                    length_factors_.data(), change_factors_.data(),
                                    inverse_masses_.data()};
    spring_functions().project(columns, spring_set.runs.data(), spring_set.runs.size(),
                               run_.x.data(), positions_before_.data(), elongations);
  }

  // Resolves contacts with colliders. If strain is limited, also prevents intersection, and reduces
  // the strain that contacts cause.
  void resolve(int step, double h) {
    contacts_.resolve(step, positions_before_, run_.x, nullptr);
    if (!(strain_limit_ > 0)) return;
    const auto resolve_contacts = [&] {
      contacts_.resolve(step, positions_before_, run_.x, nullptr, &is_moved_);
    };
    is_moved_.assign(run_.network.particle_count(), 1);
    self_contacts_.prevent_tunnelling(h, step_start_, positions_before_, run_.x, is_moved_,
                                      resolve_contacts);
    for (int pass = 0; pass < CONTACT_PASSES; ++pass) {
      std::fill(is_moved_.begin(), is_moved_.end(), 0);
      if (!limit_strains(CONTACT_STRAIN_FACTOR * strain_limit_, &is_moved_)) return;
      resolve_contacts();
      self_contacts_.prevent_tunnelling(h, step_start_, positions_before_, run_.x, is_moved_,
                                        resolve_contacts);
    }
  }

  void pull_anchors() {
    const SpringNetwork& network = run_.network;
    for (std::size_t a = 0; a < network.anchors.size(); ++a) {
      const std::size_t row = PARTICLE_STRIDE * static_cast<std::size_t>(network.anchors[a]);
      const double inverse_mass = network.inverse_masses[row / PARTICLE_STRIDE];
      for (std::size_t k = 0; k < 3; ++k) {
        const double offset = run_.anchor_points[3 * a + k] - run_.x[row + k];
        const double offset_change =
            offset - (run_.anchor_points_before[3 * a + k] - positions_before_[row + k]);
        run_.x[row + k] += inverse_mass * (anchor_factors_[a].length * offset +
                                           anchor_factors_[a].change * offset_change);
      }
    }
  }

  // Clamps the strain of stiff springs. Both ends move, so that momentum is conserved. Returns
  // whether any particle moved, and marks those that did.
  bool limit_strains(double strain_limit, std::vector<std::uint8_t>* marks = nullptr) {
    bool has_moved = false;
    for (int pass = 0; pass < STRAIN_LIMIT_PASSES; ++pass) {
      bool has_corrected = false;
      for (const StiffSpring& spring : stiff_springs_) {
        double *p = run_.x.data() + spring.i, *q = run_.x.data() + spring.j;
        const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
        const double square = dot3(d, d), min_length = spring.rest_length * (1 - strain_limit),
                     max_length = spring.rest_length * (1 + strain_limit);
        if (!(square > max_length * max_length || (square < min_length * min_length && square > 0)))
          continue;
        const double length = std::sqrt(square);
        const double correction = (length - std::clamp(length, min_length, max_length)) / length;
        for (std::size_t k = 0; k < 3; ++k) {
          p[k] += spring.first_inverse_mass * correction * d[k];
          q[k] -= spring.last_inverse_mass * correction * d[k];
        }
        if (marks) (*marks)[spring.i / PARTICLE_STRIDE] = (*marks)[spring.j / PARTICLE_STRIDE] = 1;
        has_corrected = true;
      }
      if (!has_corrected) break;
      has_moved = true;
    }
    return has_moved;
  }

  // Removes the relative velocity of ends along stiff springs, so that strain limiting adds no
  // speed.
  void damp_stiff_springs() {
    for (const StiffSpring& spring : stiff_springs_) {
      const double *p = run_.x.data() + spring.i, *q = run_.x.data() + spring.j;
      double *u = run_.v.data() + spring.i, *v = run_.v.data() + spring.j;
      const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
      const double relative[3] = {v[0] - u[0], v[1] - u[1], v[2] - u[2]};
      const double square = dot3(d, d);
      if (!(square > 0)) continue;
      const double correction = dot3(d, relative) / square;
      for (std::size_t k = 0; k < 3; ++k) {
        u[k] += spring.first_inverse_mass * correction * d[k];
        v[k] -= spring.last_inverse_mass * correction * d[k];
      }
    }
  }

  // Largest strain that is not mostly due to compliance.
  double max_strain() const {
    double largest = 0;
    for (std::size_t s = 0; s < run_.spring_set().springs.size(); ++s) {
      const Spring& spring = run_.spring_set().springs[s];
      if (!(spring.rest_length > 0) || !(spring.stiffness > 0)) continue;
      const double* p = run_.x.data() + PARTICLE_STRIDE * static_cast<std::size_t>(spring.i);
      const double* q = run_.x.data() + PARTICLE_STRIDE * static_cast<std::size_t>(spring.j);
      const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
      const double square = dot3(d, d), bound = spring.rest_length * (1 + largest);
      if (square <= bound * bound) continue;
      const double elongation = std::sqrt(square) - spring.rest_length;
      const double load_elongation = std::max(0.0, elongations_[s]);
      largest = std::max(
          largest, std::min(elongation, COMPLIANT_STRAIN_RATIO * (elongation - load_elongation)) /
                       spring.rest_length);
      if (square != square) return std::numeric_limits<double>::infinity();
    }
    return largest;
  }

  SpringRun& run_;
  SpringContacts& contacts_;
  SelfContacts& self_contacts_;
  double interval_duration_, strain_limit_;
  int prepared_substeps_ = 0;
  struct StiffSpring {
    std::size_t i, j;  // offsets of rows
    double rest_length, first_inverse_mass, last_inverse_mass;
  };
  std::vector<StiffSpring> stiff_springs_;
  std::vector<double> step_start_;      // positions at the start of a step
  std::vector<std::uint8_t> is_moved_;  // particles moved since the last test
  std::vector<double> positions_before_, forces_, length_factors_, change_factors_, inverse_masses_;
  std::vector<double> elongations_;  // elongation of springs right after their correction
  std::vector<CorrectionFactors> anchor_factors_;
};

}  // namespace

SpringProjectResult project_springs(
    const SpringNetwork& network, In<double, 3> state, In<std::uint8_t, 1> is_torn, double origin,
    std::int64_t first_interval, double interval_duration, std::int64_t interval_count,
    int substeps, int low_strain_count, int min_substeps, int max_substeps, double repeat_strain,
    const std::optional<SpringColliders>& colliders, const SpringLayers* layers,
    In<std::int64_t, 2> initial_intersections, double strain_limit) {
  const IntervalGrid grid{origin, first_interval, interval_duration, interval_count};
  check::between("max_substeps", max_substeps, 1, static_cast<int>(MAX_SUBSTEPS));
  check::between("min_substeps", min_substeps, 1, static_cast<int>(MAX_SUBSTEPS));
  check_intervals(grid, substeps);
  check_intervals(grid, std::max(substeps, max_substeps));
  check::between("low_strain_count", low_strain_count, 0, std::numeric_limits<int>::max() / 2);
  if (!(repeat_strain >= 0))
    check::refuse("repeat_strain", check::text(repeat_strain) + " is not 0 or more");
  check::non_negative("strain_limit", strain_limit);
  check::finite("state", state);
  SpringRun run = build_run(network, state, is_torn);
  SpringContacts contacts(colliders, network, interval_count, strain_limit > 0);
  SelfContacts self_contacts(layers, network, initial_intersections, strain_limit > 0);
  double largest_strain = 0;
  std::int64_t total_steps = 0;
  Projection projection(run, interval_duration, strain_limit, contacts, self_contacts);
  std::vector<double> x, v;
  for (std::int64_t i = 0; i < interval_count; ++i) {
    x = run.x;
    v = run.v;
    double strain = projection.advance_interval(i, grid.start(i), substeps);
    total_steps += substeps;
    const double strain_bound = strain_limit > 0
                                    ? std::max(repeat_strain, MAX_STRAIN_EXCESS * strain_limit)
                                    : repeat_strain;
    const auto has_new_intersections = [&] {
      return strain_limit > 0 &&
             self_contacts.intersection_count() > self_contacts.initial_intersection_count();
    };
    bool is_improving = true;
    while ((!(strain <= strain_bound) || has_new_intersections()) && substeps < max_substeps &&
           is_improving) {
      substeps = std::min(2 * substeps, max_substeps);
      low_strain_count = 0;
      run.x = x;
      run.v = v;
      const double previous_strain = strain;
      strain = projection.advance_interval(i, grid.start(i), substeps);
      total_steps += substeps;
      // Shorter steps do not reduce the strain that contacts and pinned particles impose.
      if (strain_limit > 0)
        is_improving =
            has_new_intersections() || strain <= MAX_REDUCED_STRAIN_RATIO * previous_strain;
    }
    if (strain_limit > 0 && strain <= strain_bound && !has_new_intersections() &&
        substeps > min_substeps)
      substeps = std::max(substeps / 2, min_substeps);
    largest_strain = std::max(largest_strain, strain);
    self_contacts.update_max_counts();
    low_strain_count = strain <= RELAXED_STRAIN_FRACTION * repeat_strain ? low_strain_count + 1 : 0;
    if (low_strain_count >= CALM_INTERVAL_COUNT && substeps > min_substeps) {
      substeps = std::max(substeps / 2, min_substeps);
      low_strain_count = 0;
    }
    if (run.tear()) projection.invalidate();
  }
  return {copy_state(run),
          copy_torn(run),
          substeps,
          low_strain_count,
          largest_strain,
          total_steps,
          contacts.touched_count,
          contacts.unresolved_count,
          self_contacts.intersections(),
          self_contacts.max_counts(),
          contacts.impulses()};
}

}  // namespace animtool
