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
  if (torn.shape(0) != network.springs.size())
    throw std::invalid_argument("torn is (S,)");
  return {network, state.data(), state.data() + 3 * count, torn.data()};
}

Out<double, 3> ended_state(const SpringRun& run) {
  Buffer<double> result(2 * run.size);
  std::copy(run.x.begin(), run.x.end(), result.get());
  std::copy(run.v.begin(), run.v.end(), result.get() + run.size);
  const std::size_t shape[3] = {2, run.network.particles(), 3};
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
  Buffer<double> result(run.size);
  {
    nb::gil_scoped_release release;
    run.look(t, h);
    run.accelerate(run.x.data(), run.v.data(), result.get());
  }
  const std::size_t shape[2] = {network.particles(), 3};
  return result.release(shape);
}

SpringsStepped step_springs(const SpringNetwork& network, In<double, 3> state,
                            In<std::uint8_t, 1> torn, double origin, std::int64_t first,
                            double cell, std::int64_t cells, int substeps) {
  SpringRun run = begin_springs(network, state, torn);
  const Cells grid{origin, first, cell, cells};
  {
    nb::gil_scoped_release release;
    const double h = cell / substeps;
    std::vector<double> rate(run.size), before(run.size);
    for (std::int64_t i = 0; i < cells; ++i) {
      for (int j = 0; j < substeps; ++j) {
        const double t = grid.start(i) + j * h;
        run.look(t, h);
        run.accelerate(run.x.data(), run.v.data(), rate.data());
        if (!network.held.empty()) before = run.x;
        for (std::size_t k = 0; k < run.size; ++k) {
          run.v[k] += h * rate[k];
          run.x[k] += h * run.v[k];
        }
        network.place_held(t + h, h, before.data(), run.x.data(), run.v.data());
      }
      if (run.tears) run.tear();
    }
  }
  return {ended_state(run), ended_torn(run)};
}

}  // namespace animtool
