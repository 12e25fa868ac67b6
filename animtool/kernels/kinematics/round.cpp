// Rounds points to float32 and measures the error; continues signs of quaternions.
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

// Vertices rounded at once: what is known of them stays next to the processor.
constexpr std::size_t STRIP = 256;

// Rounds values divided by the unit, and finds how far each moved, squared.
template <bool Divided>
void round_strip(const double* __restrict p, std::size_t count, double unit, float* __restrict out,
                 double* __restrict squares) {
  for (std::size_t i = 0; i < count; ++i) {
    const double value = Divided ? p[i] / unit : p[i];
    const float rounded = static_cast<float>(value);
    const double off = rounded - value;
    out[i] = rounded;
    squares[i] = off * off;
  }
}

// Brings back values that are beyond what float32 holds.
void clamp_strip(const double* p, std::size_t count, double unit, float* out, double* squares) {
  constexpr double limit = std::numeric_limits<float>::max();
  for (std::size_t i = 0; i < count; ++i) {
    const double value = p[i] / unit, inside = std::clamp(value, -limit, limit);
    if (inside == value) continue;
    out[i] = static_cast<float>(inside);
    const double off = inside - value;
    squares[i] = off * off;
  }
}

constexpr double UNBOUNDED = std::numeric_limits<double>::infinity();

// The largest sum of three squares in a row; infinite where one is no finite number.
double largest_sum(const double* s, std::size_t vertices) {
  double worst[2] = {0, 0};
  bool finite = true;
  for (std::size_t i = 0; i < vertices; ++i, s += 3) {
    const double sum = s[0] + s[1] + s[2];
    worst[i % 2] = sum > worst[i % 2] ? sum : worst[i % 2];
    finite &= sum < UNBOUNDED;
  }
  return finite ? std::max(worst[0], worst[1]) : UNBOUNDED;
}

}  // namespace

RoundedPoints round_points(In<double, 3> points, double unit) {
  const std::size_t frames = points.shape(0), vertices = points.shape(1);
  check::shape("points", points, {check::ANY, check::ANY, 3});
  check::positive("unit", unit);
  Out<float, 3> rounded(frames, vertices, 3);
  double largest = 0;
  std::size_t at = 0;
  const auto round = unit == 1.0 ? round_strip<false> : round_strip<true>;
  const std::size_t total = frames * vertices;
  double squares[STRIP * 3];
  for (std::size_t v = 0; v < total; v += STRIP) {
    const double* p = points.data() + 3 * v;
    float* out = rounded.get() + 3 * v;
    const std::size_t count = std::min(STRIP, total - v);
    round(p, count * 3, unit, out, squares);
    double worst = largest_sum(squares, count);
    if (worst == UNBOUNDED) {
      clamp_strip(p, count * 3, unit, out, squares);
      worst = largest_sum(squares, count);
    }
    // Few strips hold a new largest error.
    if (worst > largest) {
      largest = worst;
      const double* s = squares;
      for (at = v; s[0] + s[1] + s[2] < worst; ++at) s += 3;
    }
  }
  const std::size_t row = std::max<std::size_t>(vertices, 1);
  return {std::move(rounded), std::sqrt(largest) * unit, at / row, at % row};
}

// By whether a product is negative: without a branch, which nothing could predict.
constexpr float SIGN[] = {1.0f, -1.0f};

std::optional<Out<float, 3>> continue_signs(In<float, 3> rotations, In<float, 2> previous) {
  const std::size_t frames = rotations.shape(0), joints = rotations.shape(1);
  check::shape("rotations", rotations, {check::ANY, check::ANY, 4});
  check::shape("previous", previous, {joints, 4});
  std::optional<Out<float, 3>> continued;
  const std::size_t row = joints * 4;
  const float* q = rotations.data();
  const float* before = previous.data();
  std::vector<float> signs(joints, 1.0f);
  for (std::size_t f = 0; f < frames; ++f, before = q, q += row) {
    bool negated = false;
    for (std::size_t j = 0; j < joints; ++j) {
      double product = 0;
      for (std::size_t k = 4 * j; k < 4 * j + 4; ++k) {
        product += static_cast<double>(q[k]) * before[k];
      }
      signs[j] *= SIGN[product < 0];
      negated |= signs[j] < 0;
    }
    if (negated && !continued) {
      continued.emplace(frames, joints, 4);
      std::copy_n(rotations.data(), f * row, continued->get());
    }
    if (!continued) continue;
    float* out = continued->get() + f * row;
    for (std::size_t j = 0; j < joints; ++j) {
      for (std::size_t k = 4 * j; k < 4 * j + 4; ++k) out[k] = q[k] * signs[j];
    }
  }
  return continued;
}

}  // namespace animtool
