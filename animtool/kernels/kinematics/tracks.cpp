// Converts float32 rotation tracks of files to float64 arrays of takes.
#include <cmath>
#include <limits>
#include <vector>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

// Frames that are read of one track before the next, whose numbers stay in the cache.
constexpr std::size_t kRun = 64;

}  // namespace

std::tuple<double, double> squared_lengths(In<float, 2> quaternions) {
  check::shape("quaternions", quaternions, {check::ANY, 4});
  const float* q = quaternions.data();
  const std::size_t count = quaternions.shape(0);
  float low = std::numeric_limits<float>::infinity(), high = 0, unusual_bits = 0;
  for (std::size_t i = 0; i < count; ++i, q += 4) {
    const float square = (q[0] * q[0] + q[1] * q[1]) + (q[2] * q[2] + q[3] * q[3]);
    low = square < low ? square : low;
    high = square > high ? square : high;
    unusual_bits += square - square;  // 0, and NaN of what is not finite
  }
  if (unusual_bits != 0) low = high = std::numeric_limits<float>::quiet_NaN();
  return {low, high};
}

Out<double, 3> unpack_rotations(const std::vector<In<float, 2>>& tracks,
                                std::optional<In<double, 2>> previous) {
  const std::size_t joints = tracks.size();
  const std::size_t frames = joints ? tracks[0].shape(0) : 0;
  for (const auto& track : tracks) check::shape("tracks", track, {frames, 4});
  if (previous) check::shape("previous", *previous, {joints, 4});
  // Of each track its numbers of the frame before, and whether they are negated.
  std::vector<double> before(4 * joints), signs(joints, 1.0);
  for (std::size_t j = 0; j < joints; ++j) {
    for (int c = 0; c < 4; ++c) {
      before[4 * j + c] = previous ? previous->data()[4 * j + c] : c == 3;
    }
  }
  Out<double, 3> rotations(frames, joints, 4);
  for (std::size_t first = 0; first < frames; first += kRun) {
    const std::size_t last = first + kRun < frames ? first + kRun : frames;
    for (std::size_t j = 0; j < joints; ++j) {
      const float* q = tracks[j].data() + 4 * first;
      double* out = rotations.get() + 4 * (first * joints + j);
      double a = before[4 * j], b = before[4 * j + 1], c = before[4 * j + 2];
      double d = before[4 * j + 3], sign = signs[j];
      for (std::size_t f = first; f < last; ++f, q += 4, out += 4 * joints) {
        const double x = q[0], y = q[1], z = q[2], w = q[3];
        const double dot = (x * a + y * b) + (z * c + w * d);
        a = x, b = y, c = z, d = w;
        sign = dot < 0 ? -sign : sign;
        const double scale = sign / std::sqrt((x * x + y * y) + (z * z + w * w));
        out[0] = x * scale;
        out[1] = y * scale;
        out[2] = z * scale;
        out[3] = w * scale;
      }
      before[4 * j] = a, before[4 * j + 1] = b, before[4 * j + 2] = c;
      before[4 * j + 3] = d, signs[j] = sign;
    }
  }
  return rotations;
}

}  // namespace animtool
