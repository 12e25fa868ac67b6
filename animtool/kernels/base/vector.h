// A 3D vector of scalars or of SIMD numbers.
#pragma once

#include <cmath>

namespace animtool {

template <class N>
struct Vector3 {
  N x{}, y{}, z{};

  // Loads several vectors at once: each component is contiguous in memory. `broadcast` repeats one
  // vector.
  static Vector3 load(const double* p) { return {N::load(p), N::load(p + 4), N::load(p + 8)}; }
  static Vector3 broadcast(const double* p) { return {p[0], p[1], p[2]}; }
  void store(double* to) const { x.store(to), y.store(to + 4), z.store(to + 8); }

  friend Vector3 operator+(const Vector3& a, const Vector3& b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
  }
  friend Vector3 operator-(const Vector3& a, const Vector3& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
  }
  friend Vector3 operator-(const Vector3& a) { return {-a.x, -a.y, -a.z}; }
  friend Vector3 operator*(const Vector3& a, const N& s) { return {a.x * s, a.y * s, a.z * s}; }
  friend Vector3& operator+=(Vector3& a, const Vector3& b) { return a = a + b; }
  friend Vector3& operator-=(Vector3& a, const Vector3& b) { return a = a - b; }
  friend N dot(const Vector3& a, const Vector3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
  friend Vector3 cross(const Vector3& a, const Vector3& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
  }
};

using Vec = Vector3<double>;

inline double length(const Vec& a) { return std::sqrt(dot(a, a)); }
inline Vec load(const double* p) { return {p[0], p[1], p[2]}; }
inline void store(const Vec& a, double* p) { p[0] = a.x, p[1] = a.y, p[2] = a.z; }

}  // namespace animtool
