// Divergence-free noise: the curl of three fields of gradient noise.
#include <cmath>

#include "base/checks.h"
#include "particles/particles.h"

namespace animtool {

namespace {

// The finaliser of splitmix64 (S. Vigna, 2015).
inline std::uint64_t hash_bits(std::uint64_t z) {
  z += 0x9E3779B97F4A7C15u;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
  return z ^ (z >> 31);
}

// Converts 21 bits to a number from -1 to 1.
inline double signed_fraction(std::uint64_t bits) {
  return static_cast<double>(bits & 0x1FFFFF) * (1.0 / (1 << 20)) - 1;
}

struct Fade {
  double weight, derivative;
};

inline Fade fade(double x) {
  return {x * x * x * (x * (x * 6 - 15) + 10), 30 * x * x * (x - 1) * (x - 1)};
}

// Adds the curl of the noise at one time slice of the lattice.
void add_curl(const std::int64_t* cell, const double* cell_fraction, const Fade* fades,
              std::int64_t slice, std::uint64_t seed, double slice_weight, double* out) {
  for (int corner = 0; corner < 8; ++corner) {
    double offset[3], weight[3], weight_derivative[3];
    std::uint64_t key = seed;
    for (int i = 0; i < 3; ++i) {
      const int is_upper = corner >> i & 1;
      offset[i] = cell_fraction[i] - is_upper;
      weight[i] = is_upper ? fades[i].weight : 1 - fades[i].weight;
      weight_derivative[i] = is_upper ? fades[i].derivative : -fades[i].derivative;
      key = hash_bits(key ^ static_cast<std::uint64_t>(cell[i] + is_upper));
    }
    key = hash_bits(key ^ static_cast<std::uint64_t>(slice));
    const double product = weight[0] * weight[1] * weight[2];
    const double product_gradient[3] = {weight_derivative[0] * weight[1] * weight[2],
                                        weight[0] * weight_derivative[1] * weight[2],
                                        weight[0] * weight[1] * weight_derivative[2]};
    double gradient[3][3];
    for (int field = 0; field < 3; ++field) {
      const std::uint64_t bits = hash_bits(key + field);
      const double lattice_gradient[3] = {signed_fraction(bits), signed_fraction(bits >> 21),
                                          signed_fraction(bits >> 42)};
      const double value = lattice_gradient[0] * offset[0] + lattice_gradient[1] * offset[1] +
                           lattice_gradient[2] * offset[2];
      for (int axis = 0; axis < 3; ++axis)
        gradient[field][axis] = product * lattice_gradient[axis] + product_gradient[axis] * value;
    }
    out[0] += slice_weight * (gradient[2][1] - gradient[1][2]);
    out[1] += slice_weight * (gradient[0][2] - gradient[2][0]);
    out[2] += slice_weight * (gradient[1][0] - gradient[0][1]);
  }
}

}  // namespace

Out<double, 2> curl_noise(In<double, 2> points, In<double, 1> times, std::uint64_t seed) {
  const std::size_t count = points.shape(0);
  check::shape("points", points, {check::ANY, 3});
  check::shape("times", times, {count});
  Out<double, 2> result(count, 3);
  for (std::size_t n = 0; n < count; ++n) {
    std::int64_t cell[3];
    double cell_fraction[3];
    Fade fades[3];
    for (int i = 0; i < 3; ++i) {
      const double coordinate = points.data()[3 * n + i], low = std::floor(coordinate);
      // Beyond this, lattice cells cannot be distinguished.
      cell[i] = std::fabs(low) < 1e15 ? static_cast<std::int64_t>(low) : 0;
      cell_fraction[i] = coordinate - low;
      fades[i] = fade(cell_fraction[i]);
    }
    const double time = times.data()[n], slice_start = std::floor(time);
    const std::int64_t slice =
        std::fabs(slice_start) < 1e15 ? static_cast<std::int64_t>(slice_start) : 0;
    const double fraction = fade(time - slice_start).weight;
    // The mean of two different fields would be weaker than either field, so it is divided by this
    // amplitude.
    const double amplitude = std::sqrt(fraction * fraction + (1 - fraction) * (1 - fraction));
    double* out = result.get() + 3 * n;
    out[0] = out[1] = out[2] = 0;
    add_curl(cell, cell_fraction, fades, slice, seed, (1 - fraction) / amplitude, out);
    if (fraction > 0)
      add_curl(cell, cell_fraction, fades, slice + 1, seed, fraction / amplitude, out);
  }
  return result;
}

}  // namespace animtool
