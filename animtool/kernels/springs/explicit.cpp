// Semi-implicit Euler steps of networks of springs.
#include <algorithm>

#include "base/checks.h"
#include "springs/loops.h"
#include "springs/steps.h"

namespace animtool {

// Builds a run from a checked state.
SpringRun build_run(const SpringNetwork& network, const In<double, 3>& state,
                    const In<std::uint8_t, 1>& is_torn) {
  const std::size_t count = network.particle_count();
  check::shape("state", state, {2, count, 3});
  check::shape("is_torn", is_torn, {network.spring_set.springs.size()});
  check::indices("is_torn", is_torn, 0, 2);
  return {network, state.data(), state.data() + 3 * count, is_torn.data()};
}

// Checks the intervals of time and the number of substeps.
void check_intervals(const IntervalGrid& grid, std::int64_t substeps) {
  check::finite("origin", grid.origin);
  check::between("first_interval", grid.first_interval, -MAX_INTERVAL_INDEX, MAX_INTERVAL_INDEX);
  check::positive("interval_duration", grid.duration);
  check::between("substeps", substeps, 1, MAX_SUBSTEPS);
  check::between("interval_count", grid.count, 0, MAX_STEPS / substeps);
  // Speeds are displacements over the step length.
  const double h = grid.duration / static_cast<double>(substeps);
  if (!std::isfinite(1 / h) || !std::isfinite(grid.start(0)) ||
      !std::isfinite(grid.start(grid.count)))
    check::refuse("interval_duration", check::text(grid.duration) + " in " + check::text(substeps) +
                                           " steps is beyond what numbers can tell apart");
}

Out<double, 3> copy_state(const SpringRun& run) {
  const std::size_t count = run.network.particle_count();
  Out<double, 3> result(2, count, 3);
  for (std::size_t n = 0; n < count; ++n) {
    std::copy_n(run.x.data() + PARTICLE_STRIDE * n, 3, result.get() + 3 * n);
    std::copy_n(run.v.data() + PARTICLE_STRIDE * n, 3, result.get() + 3 * (count + n));
  }
  return result;
}

Out<std::uint8_t, 1> copy_torn(const SpringRun& run) {
  Out<std::uint8_t, 1> result(run.is_torn.size());
  std::copy(run.is_torn.begin(), run.is_torn.end(), result.get());
  return result;
}

Out<double, 2> spring_accelerations(const SpringNetwork& network, double t, double h,
                                    In<double, 3> state, In<std::uint8_t, 1> is_torn) {
  check::finite("t", t);
  check::positive("h", h);
  SpringRun run = build_run(network, state, is_torn);
  Out<double, 2> result(network.particle_count(), 3);
  std::vector<double> accelerations(run.size);
  run.sample_surroundings(t, h);
  run.accelerate(run.x.data(), run.v.data(), accelerations.data());
  for (std::size_t n = 0; n < network.particle_count(); ++n)
    std::copy_n(accelerations.data() + PARTICLE_STRIDE * n, 3, result.get() + 3 * n);
  return result;
}

Out<std::int64_t, 1> spring_order(In<std::int64_t, 2> ends, std::size_t particles) {
  check::between("particles", particles, 0, check::MAX_ROWS);
  check::shape("ends", ends, {check::ANY, 2});
  check::at_most("ends", ends.shape(0), check::MAX_ROWS);
  check::indices("ends", ends, 0, static_cast<std::int64_t>(particles));
  Out<std::int64_t, 1> result(ends.shape(0));
  const auto order = order_springs(ends.data(), ends.shape(0), particles);
  std::copy(order.begin(), order.end(), result.get());
  return result;
}

std::tuple<double, double> spring_energy(const SpringNetwork& network, In<double, 2> positions) {
  check::shape("positions", positions, {network.particle_count(), 3});
  double energy = 0, max_length_ratio = 0;
  for (const Spring& spring : network.spring_set.springs) {
    const double* p = positions.data() + 3 * static_cast<std::size_t>(spring.i);
    const double* q = positions.data() + 3 * static_cast<std::size_t>(spring.j);
    const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
    const double length = std::sqrt(dot3(d, d)), elongation = length - spring.rest_length;
    energy += 0.5 * spring.stiffness * elongation * elongation;
    if (spring.rest_length > 0 && !(length <= max_length_ratio * spring.rest_length))
      max_length_ratio = length / spring.rest_length;
  }
  return {energy, max_length_ratio};
}

namespace {

// Advances a run by semi-implicit Euler steps, with particles in columns where springs are in
// bands.
class ExplicitStepper {
 public:
  ExplicitStepper(SpringRun& run, SpringContacts& contacts)
      : run_(run), contacts_(contacts), accelerations_(run.size), positions_before_(run.size) {
    const SpringNetwork& network = run.network;
    const std::size_t height = plane_height(network.particle_count());
    const auto pad = [&](std::vector<double> numbers) {
      numbers.resize(height);
      return numbers;
    };
    inverse_masses_ = pad(network.inverse_masses);
    drags_ = pad(network.drags);
    strides_ = {1, height};
  }

  // Advances over an interval that starts at a time, in steps of h.
  void advance_interval(double start, int substeps, double h) {
    if (run_.spring_set().forces.has_bands())
      return advance_interval_in_columns(start, substeps, h);
    for (int step = 0; step < substeps; ++step) step_rows(start + step * h, h, step);
  }

  // Tears springs that are stretched beyond their limit.
  void tear() {
    if (!run_.spring_set().can_tear) return;
    sync_rows();
    run_.tear();
  }

  // Updates the rows from the columns.
  void sync_rows() {
    if (is_in_columns_ && !is_in_rows_) write_rows();
    is_in_columns_ = false;
  }

 private:
  void step_rows(double t, double h, int step) {
    const SpringNetwork& network = run_.network;
    run_.sample_surroundings(t, h);
    run_.accelerate(run_.x.data(), run_.v.data(), accelerations_.data());
    store_positions_before();
    spring_functions().advance(network.particle_count(), h, accelerations_.data(), run_.x.data(),
                               run_.v.data());
    network.set_pinned(t + h, h, positions_before_.data(), run_.x.data(), run_.v.data());
    contacts_.resolve(step, positions_before_, run_.x, &run_.v);
  }

  // Stores the positions of all particles, or of the pinned ones.
  void store_positions_before() {
    if (contacts_.has_colliders()) {
      positions_before_ = run_.x;
      return;
    }
    for (const std::int32_t particle : run_.network.pinned_particles) {
      const std::size_t row = PARTICLE_STRIDE * static_cast<std::size_t>(particle);
      std::copy_n(run_.x.data() + row, PARTICLE_STRIDE, positions_before_.data() + row);
    }
  }

  // Advances with particles in columns; they are in rows too if other forces or contacts need them.
  void advance_interval_in_columns(double start, int substeps, double h) {
    const SpringNetwork& network = run_.network;
    const SpringForces& forces = run_.spring_set().forces;
    const bool has_forces = run_.has_other_forces(), has_contacts = contacts_.has_colliders();
    is_in_rows_ = has_forces || has_contacts;
    if (!is_in_columns_) begin_columns();
    const PlaneSteps steps{inverse_masses_.data(),
                           drags_.data(),
                           {network.gravity[0], network.gravity[1], network.gravity[2]},
                           h};
    for (int step = 0; step < substeps; ++step) {
      const double t = start + step * h;
      run_.sample_surroundings(t, h);
      if (has_forces) {
        run_.compute_other_forces(run_.x.data(), run_.v.data(), accelerations_.data());
        forces.read(accelerations_.data(), buffers_.f);
      }
      forces.step(steps, buffers_);
      network.set_pinned(t + h, h, buffers_.x.data(), buffers_.x.data(), buffers_.v.data(),
                         strides_);
      if (has_contacts) positions_before_ = run_.x;
      if (is_in_rows_) write_rows();
      if (!has_contacts) continue;
      contacts_.resolve(step, positions_before_, run_.x, &run_.v);
      read_rows();
    }
  }

  void begin_columns() {
    run_.spring_set().forces.allocate(buffers_);
    read_rows();
    is_in_columns_ = true;
  }

  void read_rows() {
    run_.spring_set().forces.read(run_.x.data(), buffers_.x);
    run_.spring_set().forces.read(run_.v.data(), buffers_.v);
  }

  void write_rows() {
    run_.spring_set().forces.write(buffers_.x, run_.x.data());
    run_.spring_set().forces.write(buffers_.v, run_.v.data());
  }

  SpringRun& run_;
  SpringContacts& contacts_;
  std::vector<double> accelerations_, positions_before_;
  ForceBuffers buffers_;
  std::vector<double> inverse_masses_, drags_;  // padded columns
  Strides strides_;
  bool is_in_columns_ = false, is_in_rows_ = false;
};

}  // namespace

SpringStepResult step_springs(const SpringNetwork& network, In<double, 3> state,
                              In<std::uint8_t, 1> is_torn, double origin,
                              std::int64_t first_interval, double interval_duration,
                              std::int64_t interval_count, int substeps,
                              const std::optional<SpringColliders>& colliders) {
  const IntervalGrid grid{origin, first_interval, interval_duration, interval_count};
  check_intervals(grid, substeps);
  check::finite("state", state);
  SpringRun run = build_run(network, state, is_torn);
  SpringContacts contacts(colliders, network, interval_count);
  const double h = interval_duration / substeps;
  ExplicitStepper stepper(run, contacts);
  for (std::int64_t i = 0; i < interval_count; ++i) {
    contacts.begin_interval(i, substeps, h);
    stepper.advance_interval(grid.start(i), substeps, h);
    stepper.tear();
  }
  stepper.sync_rows();
  return {copy_state(run), copy_torn(run), contacts.unresolved_count, contacts.impulses()};
}

}  // namespace animtool
