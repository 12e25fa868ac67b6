// Vectors, row-major 3x3 matrices and quaternions (x, y, z, w) as arrays.
#pragma once

#include <algorithm>
#include <cmath>

namespace animtool::ik {

inline double dot(const double* a, const double* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

inline double length(const double* a) { return std::sqrt(dot(a, a)); }

inline void cross(const double* a, const double* b, double* c) {
  c[0] = a[1] * b[2] - a[2] * b[1];
  c[1] = a[2] * b[0] - a[0] * b[2];
  c[2] = a[0] * b[1] - a[1] * b[0];
}

// The scalar triple product a · (b × c).
inline double triple_product(const double* a, const double* b, const double* c) {
  double bc[3];
  cross(b, c, bc);
  return dot(a, bc);
}

// Multiplies a vector by a matrix.
inline void rotate(const double* m, const double* v, double* out) {
  for (int i = 0; i < 3; ++i) out[i] = dot(m + 3 * i, v);
}

inline void multiply(const double* a, const double* b, double* c) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

// The matrix of a unit quaternion.
inline void to_matrix(const double* q, double* m) {
  const double x = q[0], y = q[1], z = q[2], w = q[3];
  m[0] = 1 - 2 * (y * y + z * z), m[1] = 2 * (x * y - w * z), m[2] = 2 * (x * z + w * y);
  m[3] = 2 * (x * y + w * z), m[4] = 1 - 2 * (x * x + z * z), m[5] = 2 * (y * z - w * x);
  m[6] = 2 * (x * z - w * y), m[7] = 2 * (y * z + w * x), m[8] = 1 - 2 * (x * x + y * y);
}

// The product of two quaternions; c may be a or b.
inline void product(const double* a, const double* b, double* c) {
  const double x = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1];
  const double y = a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0];
  const double z = a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3];
  const double w = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2];
  c[0] = x, c[1] = y, c[2] = z, c[3] = w;
}

// Rotates a vector by a unit quaternion (a, w): v + w c + a × c, where c = 2 a × v.
inline void rotate_vector(const double* q, const double* v, double* out) {
  double twice_cross[3], cross_of_cross[3];
  cross(q, v, twice_cross);
  for (double& c : twice_cross) c *= 2;
  cross(q, twice_cross, cross_of_cross);
  for (int i = 0; i < 3; ++i) out[i] = v[i] + q[3] * twice_cross[i] + cross_of_cross[i];
}

inline void normalize(double* q) {
  const double n = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (int i = 0; i < 4; ++i) q[i] /= n;
}

// Normalises a quaternion of any length: scales it first, so that tiny and huge components neither
// under- nor overflow. Zero length or NaN gives the identity.
inline void make_unit(double* q) {
  double largest = 0;
  for (int i = 0; i < 4; ++i)
    if (!(std::fabs(q[i]) <= largest)) largest = std::fabs(q[i]);
  if (largest > 0) {
    for (int i = 0; i < 4; ++i) q[i] /= largest;
    normalize(q);
  } else {
    q[0] = q[1] = q[2] = 0, q[3] = 1;
  }
}

// The quaternion of a rotation vector [rad].
inline void exponential(const double* v, double* q) {
  const double angle = length(v);
  // Next to each other, so that one call of the library returns both.
  const double sine = std::sin(angle / 2), cosine = std::cos(angle / 2);
  const double factor = angle < 1e-5 ? 0.5 - angle * angle / 48 : sine / angle;
  for (int i = 0; i < 3; ++i) q[i] = factor * v[i];
  q[3] = cosine;
}

// The shortest rotation vector [rad] of a unit quaternion.
inline void logarithm(const double* q, double* v) {
  const double sine = length(q), sign = q[3] < 0 ? -1 : 1;
  const double factor =
      sine < 1e-12 ? 2 * sign : sign * 2 * std::atan2(sine, std::fabs(q[3])) / sine;
  for (int i = 0; i < 3; ++i) v[i] = factor * q[i];
}

// The rotation vector [rad] of a matrix; near 180 degrees from its largest column.
inline void logarithm_of_matrix(const double* m, double* v) {
  const double cosine = (m[0] + m[4] + m[8] - 1) / 2;
  v[0] = (m[7] - m[5]) / 2, v[1] = (m[2] - m[6]) / 2, v[2] = (m[3] - m[1]) / 2;
  const double sine = length(v);
  if (cosine > -0.9) {
    const double factor = sine < 1e-9 ? 1.0 : std::atan2(sine, cosine) / sine;
    for (int i = 0; i < 3; ++i) v[i] *= factor;
    return;
  }
  int i = m[4] > m[0] ? 1 : 0;
  if (m[8] > m[4 * i]) i = 2;
  const int j = (i + 1) % 3, k = (i + 2) % 3;
  double q[4];
  q[i] = 1 + m[4 * i] - m[4 * j] - m[4 * k];
  q[j] = m[3 * i + j] + m[3 * j + i];
  q[k] = m[3 * i + k] + m[3 * k + i];
  q[3] = m[3 * k + j] - m[3 * j + k];
  normalize(q);
  logarithm(q, v);
}

// Two unit vectors orthogonal to a unit vector and to each other.
inline void orthogonal_basis(const double* a, double* u, double* v) {
  int smallest = std::fabs(a[1]) < std::fabs(a[0]) ? 1 : 0;
  if (std::fabs(a[2]) < std::fabs(a[smallest])) smallest = 2;
  double unit[3] = {0, 0, 0};
  unit[smallest] = 1;
  cross(a, unit, u);
  const double n = length(u);
  for (int i = 0; i < 3; ++i) u[i] /= n;
  cross(a, u, v);
}

}  // namespace animtool::ik
