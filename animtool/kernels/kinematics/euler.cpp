// Converts Euler angles of any order to quaternions and back.
#include <bit>
#include <cmath>
#include <cstring>
#include <vector>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

constexpr double PI = 3.14159265358979323846;

// Computes the sine and cosine of half of each angle, up to a common sign that a quaternion does
// not need. The angle is reduced in degrees, where 180 k is exact, so that a rotation by many
// revolutions is as precise. The remainder is at most 45 degrees, where the Taylor series below are
// accurate to one unit in the last digit.
void half_sine_cosine(const double* degrees, double* sine, double* cosine, std::size_t n) {
  constexpr double ROUNDING_CONSTANT =
      6755399441055744.0;  // 1.5 * 2^52; adding it rounds to a whole number
  for (std::size_t i = 0; i < n; ++i) {
    const double rounded = degrees[i] * (1.0 / 180.0) + ROUNDING_CONSTANT;
    const double half_circles = rounded - ROUNDING_CONSTANT;
    const double half_angle = (degrees[i] - 180.0 * half_circles) * (PI / 360.0);
    const double squared = half_angle * half_angle;
    double series_sine = -1.0 / 1307674368000.0;
    series_sine = series_sine * squared + 1.0 / 6227020800.0;
    series_sine = series_sine * squared - 1.0 / 39916800.0;
    series_sine = series_sine * squared + 1.0 / 362880.0;
    series_sine = series_sine * squared - 1.0 / 5040.0;
    series_sine = series_sine * squared + 1.0 / 120.0;
    series_sine = series_sine * squared - 1.0 / 6.0;
    series_sine = series_sine * squared * half_angle + half_angle;
    double series_cosine = 1.0 / 20922789888000.0;
    series_cosine = series_cosine * squared - 1.0 / 87178291200.0;
    series_cosine = series_cosine * squared + 1.0 / 479001600.0;
    series_cosine = series_cosine * squared - 1.0 / 3628800.0;
    series_cosine = series_cosine * squared + 1.0 / 40320.0;
    series_cosine = series_cosine * squared - 1.0 / 720.0;
    series_cosine = series_cosine * squared + 1.0 / 24.0;
    series_cosine = series_cosine * squared - 0.5;
    series_cosine = series_cosine * squared + 1.0;
    // For odd quarter revolutions, (s, c) becomes (c, -s). Bit masks allow the compiler to
    // vectorise the loop.
    const auto parity_mask = std::uint64_t{0} - (std::bit_cast<std::uint64_t>(rounded) & 1);
    const auto sine_bits = std::bit_cast<std::uint64_t>(series_sine),
               cosine_bits = std::bit_cast<std::uint64_t>(series_cosine);
    const auto minus_sine_bits = sine_bits ^ (std::uint64_t{1} << 63);
    sine[i] = std::bit_cast<double>((sine_bits & ~parity_mask) | (cosine_bits & parity_mask));
    cosine[i] =
        std::bit_cast<double>((cosine_bits & ~parity_mask) | (minus_sine_bits & parity_mask));
  }
}

// Multiplies q by the rotation (s, c) about one axis.
void rotate_about_axis(double* q, int axis, double sine, double cosine) {
  const int b = (axis + 1) % 3, d = (axis + 2) % 3;
  const double w = q[3], qa = q[axis], qb = q[b], qd = q[d];
  q[3] = w * cosine - qa * sine;
  q[axis] = qa * cosine + w * sine;
  q[b] = qb * cosine + qd * sine;
  q[d] = qd * cosine - qb * sine;
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
  const double* previous_frame = previous.data();
  for (std::size_t f = 0; f < frames; ++f) {
    const double* row = values.data() + f * width;
    for (std::size_t k = 0; k < joints * 3; ++k) {
      const auto column = columns.data()[k];
      double degrees = column < 0 ? 0.0 : row[column];
      // The rounding above is valid below 2^51 half revolutions. fmod is exact for larger angles.
      if (std::fabs(degrees) > 1e12) degrees = std::fmod(degrees, 720.0);
      angle[k] = degrees;
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
      if (columns.data()[k + 1] >= 0)
        rotate_about_axis(q, axes.data()[k + 1], sine[k + 1], cosine[k + 1]);
      if (columns.data()[k + 2] >= 0)
        rotate_about_axis(q, axes.data()[k + 2], sine[k + 2], cosine[k + 2]);
      const double* previous_rotation = previous_frame + 4 * j;
      const double dot = q[0] * previous_rotation[0] + q[1] * previous_rotation[1] +
                         q[2] * previous_rotation[2] + q[3] * previous_rotation[3];
      if (dot < 0)
        for (int i = 0; i < 4; ++i) q[i] = -q[i];
    }
    previous_frame = out;
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
  const auto nearest = [](double angle, double reference) {
    return angle - 2 * PI * std::nearbyint((angle - reference) / (2 * PI));
  };
  for (std::size_t j = 0; j < joints; ++j) {
    const int i0 = axes.data()[3 * j], i1 = axes.data()[3 * j + 1], i2 = axes.data()[3 * j + 2];
    const double sign = (i1 - i0 + 3) % 3 == 1 ? 1.0 : -1.0;
    double previous_angles[3] = {0, 0, 0};
    for (std::size_t f = 0; f < frames; ++f) {
      const double* q = quaternions.data() + (f * joints + j) * 4;
      const double x = q[0], y = q[1], z = q[2], w = q[3];
      const double n = 2.0 / (x * x + y * y + z * z + w * w);
      const double m[3][3] = {{1 - n * (y * y + z * z), n * (x * y - z * w), n * (x * z + y * w)},
                              {n * (x * y + z * w), 1 - n * (x * x + z * z), n * (y * z - x * w)},
                              {n * (x * z - y * w), n * (y * z + x * w), 1 - n * (x * x + y * y)}};
      // The last angle is computed from the rotation that remains after the first is undone. It
      // thus compensates exactly for a first angle that is ill-determined near gimbal lock (K.
      // Shoemake, Euler angle conversion, Graphics Gems IV, 1994).
      const auto solve_with_first = [&](double first, double* angles) {
        const double s = std::sin(first), c = std::cos(first);
        angles[0] = first;
        angles[1] = std::atan2(sign * m[i0][i2], c * m[i2][i2] - sign * s * m[i1][i2]);
        angles[2] =
            std::atan2(c * sign * m[i1][i0] + s * m[i2][i0], c * m[i1][i1] + s * sign * m[i2][i1]);
      };
      const double middle_cosine = std::hypot(m[i1][i2], m[i2][i2]);
      // Within 1e-9 of gimbal lock any first angle is correct. The angle of the previous frame
      // makes no jump.
      const double first =
          middle_cosine > 1e-9 ? std::atan2(-sign * m[i1][i2], m[i2][i2]) : previous_angles[0];
      double solution[3], other_solution[3];
      solve_with_first(first, solution);
      solve_with_first(first + PI, other_solution);
      double squared_change = 0, other_squared_change = 0;
      for (int k = 0; k < 3; ++k) {
        solution[k] = nearest(solution[k], previous_angles[k]);
        other_solution[k] = nearest(other_solution[k], previous_angles[k]);
        squared_change += (solution[k] - previous_angles[k]) * (solution[k] - previous_angles[k]);
        other_squared_change +=
            (other_solution[k] - previous_angles[k]) * (other_solution[k] - previous_angles[k]);
      }
      const double* nearest_solution =
          other_squared_change < squared_change ? other_solution : solution;
      double* out = result.get() + (f * joints + j) * 3;
      for (int k = 0; k < 3; ++k) {
        previous_angles[k] = nearest_solution[k];
        out[k] = nearest_solution[k] * (180.0 / PI);
      }
    }
  }
  return result;
}

}  // namespace animtool
