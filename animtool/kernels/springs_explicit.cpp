// Semi-implicit Euler steps of networks of springs.
#include <algorithm>
#include <stdexcept>

#include "springs_steps.h"

namespace animtool {

SpringRun begin_springs(const SpringNetwork& network, const In<double, 3>& state,
                        const In<std::uint8_t, 1>& torn) {
  const std::size_t count = network.particles();
  if (state.shape(0) != 2 || state.shape(1) != count || state.shape(2) != 3)
    throw std::invalid_argument("the state is (2, N, 3)");
  if (torn.shape(0) != network.lines.springs.size())
    throw std::invalid_argument("torn is (S,)");
  return {network, state.data(), state.data() + 3 * count, torn.data()};
}

Out<double, 3> ended_state(const SpringRun& run) {
  const std::size_t count = run.network.particles();
  Buffer<double> result(6 * count);
  for (std::size_t n = 0; n < count; ++n) {
    std::copy_n(run.x.data() + ROW * n, 3, result.get() + 3 * n);
    std::copy_n(run.v.data() + ROW * n, 3, result.get() + 3 * (count + n));
  }
  const std::size_t shape[3] = {2, count, 3};
  return result.release(shape);
}

Out<std::uint8_t, 1> ended_torn(const SpringRun& run) {
  Buffer<std::uint8_t> result(run.torn.size());
  std::copy(run.torn.begin(), run.torn.end(), result.get());
  const std::size_t shape[1] = {run.torn.size()};
  return result.release(shape);
}

Out<double, 2> spring_accelerations(const SpringNetwork& network, double t, double h,
                                    In<double, 3> state, In<std::uint8_t, 1> torn) {
  SpringRun run = begin_springs(network, state, torn);
  Buffer<double> result(3 * network.particles());
  {
    nb::gil_scoped_release release;
    std::vector<double> rate(run.size);
    run.look(t, h);
    run.accelerate(run.x.data(), run.v.data(), rate.data());
    for (std::size_t n = 0; n < network.particles(); ++n)
      std::copy_n(rate.data() + ROW * n, 3, result.get() + 3 * n);
  }
  const std::size_t shape[2] = {network.particles(), 3};
  return result.release(shape);
}

Out<std::int64_t, 1> spring_order(In<std::int64_t, 2> ends, std::size_t particles) {
  if (ends.shape(1) != 2) throw std::invalid_argument("ends are (S, 2)");
  for (std::size_t k = 0; k < ends.size(); ++k)
    if (ends.data()[k] < 0 || ends.data()[k] >= static_cast<std::int64_t>(particles))
      throw std::invalid_argument("particles are counted from 0");
  Buffer<std::int64_t> result(ends.shape(0));
  {
    nb::gil_scoped_release release;
    const auto order = order_springs(ends.data(), ends.shape(0), particles);
    std::copy(order.begin(), order.end(), result.get());
  }
  const std::size_t shape[1] = {ends.shape(0)};
  return result.release(shape);
}

std::tuple<double, double> spring_energy(const SpringNetwork& network,
                                         In<double, 2> positions) {
  if (positions.shape(0) != network.particles() || positions.shape(1) != 3)
    throw std::invalid_argument("positions are (N, 3)");
  double energy = 0, longest = 0;
  for (const Spring& spring : network.lines.springs) {
    const double* p = positions.data() + 3 * static_cast<std::size_t>(spring.i);
    const double* q = positions.data() + 3 * static_cast<std::size_t>(spring.j);
    const double d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
    const double length = std::sqrt(dot3(d, d)), longer = length - spring.rest;
    energy += 0.5 * spring.stiffness * longer * longer;
    if (spring.rest > 0 && !(length <= longest * spring.rest)) longest = length / spring.rest;
  }
  return {energy, longest};
}

namespace {

// Keep where particles are, of all or of those that are held.
void keep(const SpringRun& run, bool all, std::vector<double>& before) {
  if (all) {
    before = run.x;
    return;
  }
  for (const std::int32_t particle : run.network.held) {
    const std::size_t at = ROW * static_cast<std::size_t>(particle);
    std::copy_n(run.x.data() + at, ROW, before.data() + at);
  }
}

}  // namespace

SpringsStepped step_springs(const SpringNetwork& network, In<double, 3> state,
                            In<std::uint8_t, 1> torn, double origin, std::int64_t first,
                            double cell, std::int64_t cells, int substeps,
                            const std::optional<SpringColliders>& colliders) {
  SpringRun run = begin_springs(network, state, torn);
  const Cells grid{origin, first, cell, cells};
  SpringContacts contacts(colliders, network.particles(), cells);
  static const AdvanceRows quads = advance_rows_in_quads();
  const AdvanceRows advance = quads ? quads : advance_rows<PlainRows>;
  {
    nb::gil_scoped_release release;
    const double h = cell / substeps;
    std::vector<double> rate(run.size), before(run.size);
    for (std::int64_t i = 0; i < cells; ++i) {
      contacts.begin_cell(i, substeps, h);
      for (int j = 0; j < substeps; ++j) {
        const double t = grid.start(i) + j * h;
        run.look(t, h);
        run.accelerate(run.x.data(), run.v.data(), rate.data());
        keep(run, contacts.any(), before);
        advance(network.particles(), h, rate.data(), run.x.data(), run.v.data());
        network.place_held(t + h, h, before.data(), run.x.data(), run.v.data());
        contacts.settle(network, j, before, run.x, &run.v);
      }
      run.tear();
    }
  }
  return {ended_state(run), ended_torn(run), contacts.unresolved};
}

}  // namespace animtool
