// Divergence-free noise: the curl of three fields of gradient noise.
#include <cmath>

#include "base/checks.h"
#include "particles/particles.h"

namespace animtool {

namespace {

// The finaliser of splitmix64 (S. Vigna, 2015).
inline std::uint64_t mixed(std::uint64_t z) {
  z += 0x9E3779B97F4A7C15u;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
  return z ^ (z >> 31);
}

// A number from -1 to 1 of 21 bits.
inline double part(std::uint64_t bits) {
  return static_cast<double>(bits & 0x1FFFFF) * (1.0 / (1 << 20)) - 1;
}

struct Fade {
  double weight, slope;
};

inline Fade fade(double x) {
  return {x * x * x * (x * (x * 6 - 15) + 10), 30 * x * x * (x - 1) * (x - 1)};
}

// Adds the curl of one time slice of the lattice.
void add_swirls(const std::int64_t* cell, const double* inside, const Fade* fades,
                std::int64_t slice, std::uint64_t seed, double share, double* out) {
  for (int corner = 0; corner < 8; ++corner) {
    double off[3], weight[3], lean[3];
    std::uint64_t key = seed;
    for (int i = 0; i < 3; ++i) {
      const int picked = corner >> i & 1;
      off[i] = inside[i] - picked;
      weight[i] = picked ? fades[i].weight : 1 - fades[i].weight;
      lean[i] = picked ? fades[i].slope : -fades[i].slope;
      key = mixed(key ^ static_cast<std::uint64_t>(cell[i] + picked));
    }
    key = mixed(key ^ static_cast<std::uint64_t>(slice));
    const double whole = weight[0] * weight[1] * weight[2];
    const double slope[3] = {lean[0] * weight[1] * weight[2], weight[0] * lean[1] * weight[2],
                             weight[0] * weight[1] * lean[2]};
    double tilt[3][3];
    for (int field = 0; field < 3; ++field) {
      const std::uint64_t bits = mixed(key + field);
      const double g[3] = {part(bits), part(bits >> 21), part(bits >> 42)};
      const double ramp = g[0] * off[0] + g[1] * off[1] + g[2] * off[2];
      for (int axis = 0; axis < 3; ++axis) tilt[field][axis] = whole * g[axis] + slope[axis] * ramp;
    }
    out[0] += share * (tilt[2][1] - tilt[1][2]);
    out[1] += share * (tilt[0][2] - tilt[2][0]);
    out[2] += share * (tilt[1][0] - tilt[0][1]);
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
    double inside[3];
    Fade fades[3];
    for (int i = 0; i < 3; ++i) {
      const double at = points.data()[3 * n + i], low = std::floor(at);
      // Beyond this, lattice cells cannot be told apart.
      cell[i] = std::fabs(low) < 1e15 ? static_cast<std::int64_t>(low) : 0;
      inside[i] = at - low;
      fades[i] = fade(inside[i]);
    }
    const double when = times.data()[n], now = std::floor(when);
    const std::int64_t slice = std::fabs(now) < 1e15 ? static_cast<std::int64_t>(now) : 0;
    const double share = fade(when - now).weight;
    // The mean of two different fields would be weaker than either.
    const double size = std::sqrt(share * share + (1 - share) * (1 - share));
    double* out = result.get() + 3 * n;
    out[0] = out[1] = out[2] = 0;
    add_swirls(cell, inside, fades, slice, seed, (1 - share) / size, out);
    if (share > 0) add_swirls(cell, inside, fades, slice + 1, seed, share / size, out);
  }
  return result;
}

}  // namespace animtool
