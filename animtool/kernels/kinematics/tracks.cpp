// Converts float32 rotation tracks of files to float64 arrays of takes.
#include <cmath>
#include <limits>
#include <vector>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

// Number of frames that are read from one track before the next, so that they stay in the cache.
constexpr std::size_t BLOCK_FRAMES = 64;

}  // namespace

std::tuple<double, double> squared_lengths(In<float, 2> quaternions) {
  check::shape("quaternions", quaternions, {check::ANY, 4});
  const float* quaternion = quaternions.data();
  const std::size_t count = quaternions.shape(0);
  float min_squared = std::numeric_limits<float>::infinity(), max_squared = 0, finiteness_sum = 0;
  for (std::size_t i = 0; i < count; ++i, quaternion += 4) {
    const float squared_length = (quaternion[0] * quaternion[0] + quaternion[1] * quaternion[1]) +
                                 (quaternion[2] * quaternion[2] + quaternion[3] * quaternion[3]);
    min_squared = squared_length < min_squared ? squared_length : min_squared;
    max_squared = squared_length > max_squared ? squared_length : max_squared;
    finiteness_sum += squared_length - squared_length;  // 0, or NaN if not finite
  }
  if (finiteness_sum != 0) min_squared = max_squared = std::numeric_limits<float>::quiet_NaN();
  return {min_squared, max_squared};
}

Out<double, 3> unpack_rotations(const std::vector<In<float, 2>>& tracks,
                                std::optional<In<double, 2>> previous) {
  const std::size_t joints = tracks.size();
  const std::size_t frames = joints ? tracks[0].shape(0) : 0;
  for (const auto& track : tracks) check::shape("tracks", track, {frames, 4});
  if (previous) check::shape("previous", *previous, {joints, 4});
  // The quaternion of each track in the previous frame, and the sign applied to it.
  std::vector<double> previous_values(4 * joints), signs(joints, 1.0);
  for (std::size_t j = 0; j < joints; ++j) {
    for (int c = 0; c < 4; ++c) {
      previous_values[4 * j + c] = previous ? previous->data()[4 * j + c] : c == 3;
    }
  }
  Out<double, 3> rotations(frames, joints, 4);
  for (std::size_t first_frame = 0; first_frame < frames; first_frame += BLOCK_FRAMES) {
    const std::size_t end_frame =
        first_frame + BLOCK_FRAMES < frames ? first_frame + BLOCK_FRAMES : frames;
    for (std::size_t j = 0; j < joints; ++j) {
      const float* values = tracks[j].data() + 4 * first_frame;
      double* out = rotations.get() + 4 * (first_frame * joints + j);
      double a = previous_values[4 * j], b = previous_values[4 * j + 1],
             c = previous_values[4 * j + 2];
      double d = previous_values[4 * j + 3], sign = signs[j];
      for (std::size_t f = first_frame; f < end_frame; ++f, values += 4, out += 4 * joints) {
        const double x = values[0], y = values[1], z = values[2], w = values[3];
        const double dot = (x * a + y * b) + (z * c + w * d);
        a = x, b = y, c = z, d = w;
        sign = dot < 0 ? -sign : sign;
        const double scale = sign / std::sqrt((x * x + y * y) + (z * z + w * w));
        out[0] = x * scale;
        out[1] = y * scale;
        out[2] = z * scale;
        out[3] = w * scale;
      }
      previous_values[4 * j] = a, previous_values[4 * j + 1] = b, previous_values[4 * j + 2] = c;
      previous_values[4 * j + 3] = d, signs[j] = sign;
    }
  }
  return rotations;
}

}  // namespace animtool
