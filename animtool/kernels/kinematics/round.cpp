// Rounds points to float32 and measures the error, and continues the signs of quaternions.
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

// Number of vertices that are rounded at once, so that their data stay in the cache.
constexpr std::size_t BLOCK_VERTICES = 256;

// Rounds values divided by the unit, and computes the square of each change.
template <bool divides_by_unit>
void round_block(const double* __restrict values, std::size_t count, double unit,
                 float* __restrict out, double* __restrict squares) {
  for (std::size_t i = 0; i < count; ++i) {
    const double value = divides_by_unit ? values[i] / unit : values[i];
    const float rounded = static_cast<float>(value);
    const double error = rounded - value;
    out[i] = rounded;
    squares[i] = error * error;
  }
}

// Clamps values that exceed the range of float32.
void clamp_block(const double* values, std::size_t count, double unit, float* out,
                 double* squares) {
  constexpr double limit = std::numeric_limits<float>::max();
  for (std::size_t i = 0; i < count; ++i) {
    const double value = values[i] / unit, clamped_value = std::clamp(value, -limit, limit);
    if (clamped_value == value) continue;
    out[i] = static_cast<float>(clamped_value);
    const double error = clamped_value - value;
    squares[i] = error * error;
  }
}

constexpr double INF = std::numeric_limits<double>::infinity();

// The largest sum of three consecutive squares. Infinite if a sum is not finite.
double largest_sum(const double* squares, std::size_t vertices) {
  double max_sum[2] = {0, 0};
  bool is_finite = true;
  for (std::size_t i = 0; i < vertices; ++i, squares += 3) {
    const double sum = squares[0] + squares[1] + squares[2];
    max_sum[i % 2] = sum > max_sum[i % 2] ? sum : max_sum[i % 2];
    is_finite &= sum < INF;
  }
  return is_finite ? std::max(max_sum[0], max_sum[1]) : INF;
}

}  // namespace

RoundedPoints round_points(In<double, 3> points, double unit) {
  const std::size_t frames = points.shape(0), vertices = points.shape(1);
  check::shape("points", points, {check::ANY, check::ANY, 3});
  check::positive("unit", unit);
  Out<float, 3> rounded(frames, vertices, 3);
  double max_squared_error = 0;
  std::size_t worst_vertex = 0;
  const auto round = unit == 1.0 ? round_block<false> : round_block<true>;
  const std::size_t point_count = frames * vertices;
  double squares[BLOCK_VERTICES * 3];
  for (std::size_t first = 0; first < point_count; first += BLOCK_VERTICES) {
    const double* values = points.data() + 3 * first;
    float* out = rounded.get() + 3 * first;
    const std::size_t count = std::min(BLOCK_VERTICES, point_count - first);
    round(values, count * 3, unit, out, squares);
    double block_max = largest_sum(squares, count);
    if (block_max == INF) {
      clamp_block(values, count * 3, unit, out, squares);
      block_max = largest_sum(squares, count);
    }
    // Few blocks contain a new largest error.
    if (block_max > max_squared_error) {
      max_squared_error = block_max;
      const double* row_squares = squares;
      for (worst_vertex = first; row_squares[0] + row_squares[1] + row_squares[2] < block_max;
           ++worst_vertex)
        row_squares += 3;
    }
  }
  const std::size_t row_size = std::max<std::size_t>(vertices, 1);
  return {std::move(rounded), std::sqrt(max_squared_error) * unit, worst_vertex / row_size,
          worst_vertex % row_size};
}

// Indexed by whether a product is negative. A branch would be unpredictable here.
constexpr float SIGN_FACTORS[] = {1.0f, -1.0f};

std::optional<Out<float, 3>> continue_signs(In<float, 3> rotations, In<float, 2> previous) {
  const std::size_t frames = rotations.shape(0), joints = rotations.shape(1);
  check::shape("rotations", rotations, {check::ANY, check::ANY, 4});
  check::shape("previous", previous, {joints, 4});
  std::optional<Out<float, 3>> continued_rotations;
  const std::size_t row_size = joints * 4;
  const float* frame_rotations = rotations.data();
  const float* previous_frame = previous.data();
  std::vector<float> signs(joints, 1.0f);
  for (std::size_t f = 0; f < frames;
       ++f, previous_frame = frame_rotations, frame_rotations += row_size) {
    bool is_negated = false;
    for (std::size_t j = 0; j < joints; ++j) {
      double product = 0;
      for (std::size_t k = 4 * j; k < 4 * j + 4; ++k) {
        product += static_cast<double>(frame_rotations[k]) * previous_frame[k];
      }
      signs[j] *= SIGN_FACTORS[product < 0];
      is_negated |= signs[j] < 0;
    }
    if (is_negated && !continued_rotations) {
      continued_rotations.emplace(frames, joints, 4);
      std::copy_n(rotations.data(), f * row_size, continued_rotations->get());
    }
    if (!continued_rotations) continue;
    float* out = continued_rotations->get() + f * row_size;
    for (std::size_t j = 0; j < joints; ++j) {
      for (std::size_t k = 4 * j; k < 4 * j + 4; ++k) out[k] = frame_rotations[k] * signs[j];
    }
  }
  return continued_rotations;
}

}  // namespace animtool
