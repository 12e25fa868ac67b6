// Euler angles of any order to quaternions and back.
#include <bit>
#include <cmath>
#include <cstring>
#include <vector>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

constexpr double kPi = 3.14159265358979323846;

// Sine and cosine of half of each angle, up to a common sign (which a quaternion
// does not need). The angle is reduced in degrees, where 180 k is exact, so that
// a spin of a thousand turns loses nothing; the remainder is at most 45 degrees,
// where the Taylor series below are within one unit in the last place.
void half_sine_cosine(const double* degrees, double* sine, double* cosine, std::size_t n) {
  constexpr double kRound = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer
  for (std::size_t i = 0; i < n; ++i) {
    const double shifted = degrees[i] * (1.0 / 180.0) + kRound;
    const double half_circles = shifted - kRound;
    const double x = (degrees[i] - 180.0 * half_circles) * (kPi / 360.0);
    const double x2 = x * x;
    double s = -1.0 / 1307674368000.0;
    s = s * x2 + 1.0 / 6227020800.0;
    s = s * x2 - 1.0 / 39916800.0;
    s = s * x2 + 1.0 / 362880.0;
    s = s * x2 - 1.0 / 5040.0;
    s = s * x2 + 1.0 / 120.0;
    s = s * x2 - 1.0 / 6.0;
    s = s * x2 * x + x;
    double c = 1.0 / 20922789888000.0;
    c = c * x2 - 1.0 / 87178291200.0;
    c = c * x2 + 1.0 / 479001600.0;
    c = c * x2 - 1.0 / 3628800.0;
    c = c * x2 + 1.0 / 40320.0;
    c = c * x2 - 1.0 / 720.0;
    c = c * x2 + 1.0 / 24.0;
    c = c * x2 - 0.5;
    c = c * x2 + 1.0;
    // Odd quarter turns: (s, c) becomes (c, -s). Bit masks, so that the loop vectorises.
    const auto parity_mask = std::uint64_t{0} - (std::bit_cast<std::uint64_t>(shifted) & 1);
    const auto sb = std::bit_cast<std::uint64_t>(s), cb = std::bit_cast<std::uint64_t>(c);
    const auto minus_sb = sb ^ (std::uint64_t{1} << 63);
    sine[i] = std::bit_cast<double>((sb & ~parity_mask) | (cb & parity_mask));
    cosine[i] = std::bit_cast<double>((cb & ~parity_mask) | (minus_sb & parity_mask));
  }
}

// q becomes q times the rotation (s, c) about one axis.
void rotate(double* q, int axis, double s, double c) {
  const int b = (axis + 1) % 3, d = (axis + 2) % 3;
  const double w = q[3], qa = q[axis], qb = q[b], qd = q[d];
  q[3] = w * c - qa * s;
  q[axis] = qa * c + w * s;
  q[b] = qb * c + qd * s;
  q[d] = qd * c - qb * s;
}

}  // namespace

Out<double, 3> euler_to_quaternion(In<double, 2> values, In<std::int32_t, 2> columns,
                                   In<std::int32_t, 2> axes, In<double, 2> previous) {
  const std::size_t frames = values.shape(0), width = values.shape(1), joints = columns.shape(0);
  check::shape("values", values, {check::ANY, check::ANY});
  check::shape("columns", columns, {check::ANY, 3});
  check::shape("axes", axes, {joints, 3});
  check::shape("previous", previous, {joints, 4});
  check::indices("columns", columns, -1, static_cast<std::int64_t>(width));
  check::indices("axes", axes, 0, 3);
  Out<double, 3> result(frames, joints, 4);
  std::vector<double> angle(joints * 3), sine(joints * 3), cosine(joints * 3);
  const double* before = previous.data();
  for (std::size_t f = 0; f < frames; ++f) {
    const double* row = values.data() + f * width;
    for (std::size_t k = 0; k < joints * 3; ++k) {
      const auto column = columns.data()[k];
      double a = column < 0 ? 0.0 : row[column];
      // The rounding trick holds below 2^51 half turns; fmod is exact above.
      if (std::fabs(a) > 1e12) a = std::fmod(a, 720.0);
      angle[k] = a;
    }
    half_sine_cosine(angle.data(), sine.data(), cosine.data(), joints * 3);
    double* out = result.get() + f * joints * 4;
    for (std::size_t j = 0; j < joints; ++j) {
      double* q = out + 4 * j;
      const std::size_t k = 3 * j;
      const int first = axes.data()[k];
      q[0] = q[1] = q[2] = 0.0;
      q[3] = cosine[k];
      q[first] = sine[k];
      if (columns.data()[k + 1] >= 0) rotate(q, axes.data()[k + 1], sine[k + 1], cosine[k + 1]);
      if (columns.data()[k + 2] >= 0) rotate(q, axes.data()[k + 2], sine[k + 2], cosine[k + 2]);
      const double* last = before + 4 * j;
      const double dot = q[0] * last[0] + q[1] * last[1] + q[2] * last[2] + q[3] * last[3];
      if (dot < 0)
        for (int i = 0; i < 4; ++i) q[i] = -q[i];
    }
    before = out;
  }
  return result;
}

Out<double, 3> quaternion_to_euler(In<double, 3> quaternions, In<std::int32_t, 2> axes) {
  const std::size_t frames = quaternions.shape(0), joints = quaternions.shape(1);
  check::shape("quaternions", quaternions, {check::ANY, check::ANY, 4});
  check::shape("axes", axes, {joints, 3});
  check::indices("axes", axes, 0, 3);
  for (std::size_t j = 0; j < joints; ++j) {
    const std::int32_t* a = axes.data() + 3 * j;
    if (((1 << a[0]) | (1 << a[1]) | (1 << a[2])) != 7)
      check::refuse("axes", "row " + check::text(j) + " does not name X, Y and Z once each");
  }
  Out<double, 3> result(frames, joints, 3);
  const auto nearest = [](double angle, double to) {
    return angle - 2 * kPi * std::nearbyint((angle - to) / (2 * kPi));
  };
  for (std::size_t j = 0; j < joints; ++j) {
    const int i0 = axes.data()[3 * j], i1 = axes.data()[3 * j + 1], i2 = axes.data()[3 * j + 2];
    const double sign = (i1 - i0 + 3) % 3 == 1 ? 1.0 : -1.0;
    double last[3] = {0, 0, 0};
    for (std::size_t f = 0; f < frames; ++f) {
      const double* q = quaternions.data() + (f * joints + j) * 4;
      const double x = q[0], y = q[1], z = q[2], w = q[3];
      const double n = 2.0 / (x * x + y * y + z * z + w * w);
      const double m[3][3] = {{1 - n * (y * y + z * z), n * (x * y - z * w), n * (x * z + y * w)},
                              {n * (x * y + z * w), 1 - n * (x * x + z * z), n * (y * z - x * w)},
                              {n * (x * z - y * w), n * (y * z + x * w), 1 - n * (x * x + y * y)}};
      // The last angle is read off what is left once the first is undone, so an
      // ill-determined first angle near gimbal lock is made up for exactly
      // (K. Shoemake, Euler angle conversion, Graphics Gems IV, 1994).
      const auto with_first = [&](double first, double* angles) {
        const double s = std::sin(first), c = std::cos(first);
        angles[0] = first;
        angles[1] = std::atan2(sign * m[i0][i2], c * m[i2][i2] - sign * s * m[i1][i2]);
        angles[2] =
            std::atan2(c * sign * m[i1][i0] + s * m[i2][i0], c * m[i1][i1] + s * sign * m[i2][i1]);
      };
      const double across = std::hypot(m[i1][i2], m[i2][i2]);
      // Within 1e-9 of gimbal lock any first angle will do: the last frame's is
      // the one that makes no jump.
      const double first = across > 1e-9 ? std::atan2(-sign * m[i1][i2], m[i2][i2]) : last[0];
      double one[3], two[3];
      with_first(first, one);
      with_first(first + kPi, two);
      double d1 = 0, d2 = 0;
      for (int k = 0; k < 3; ++k) {
        one[k] = nearest(one[k], last[k]);
        two[k] = nearest(two[k], last[k]);
        d1 += (one[k] - last[k]) * (one[k] - last[k]);
        d2 += (two[k] - last[k]) * (two[k] - last[k]);
      }
      const double* best = d2 < d1 ? two : one;
      double* out = result.get() + (f * joints + j) * 3;
      for (int k = 0; k < 3; ++k) {
        last[k] = best[k];
        out[k] = best[k] * (180.0 / kPi);
      }
    }
  }
  return result;
}

}  // namespace animtool
