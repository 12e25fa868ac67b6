// Two doubles worked on at once: the same numbers as one by one, and the vector
// registers of every baseline processor hold them.
#pragma once

#include "base/vector.h"

namespace animtool {

#if defined(__GNUC__) || defined(__clang__)

using Pair = double __attribute__((vector_size(16)));

// a where x < limit, else b; lane by lane.
inline Pair where_below(Pair x, Pair limit, Pair a, Pair b) { return x < limit ? a : b; }

#else

struct Pair {
  double lane[2];
  double operator[](int i) const { return lane[i]; }
  Pair& operator+=(Pair b) { return *this = {lane[0] + b[0], lane[1] + b[1]}; }
};

inline Pair operator+(Pair a, Pair b) { return {a[0] + b[0], a[1] + b[1]}; }
inline Pair operator-(Pair a, Pair b) { return {a[0] - b[0], a[1] - b[1]}; }
inline Pair operator*(Pair a, Pair b) { return {a[0] * b[0], a[1] * b[1]}; }
inline Pair operator/(Pair a, Pair b) { return {a[0] / b[0], a[1] / b[1]}; }
inline Pair operator-(Pair a) { return {-a[0], -a[1]}; }
inline Pair where_below(Pair x, Pair limit, Pair a, Pair b) {
  return {x[0] < limit[0] ? a[0] : b[0], x[1] < limit[1] ? a[1] : b[1]};
}

#endif

inline Pair both(double value) { return Pair{value, value}; }

// A vector of each of two frames.
using Vector = Vector3<Pair>;

inline Vector load(const double* a, const double* b) {
  return {Pair{a[0], b[0]}, Pair{a[1], b[1]}, Pair{a[2], b[2]}};
}

inline void store(const Vector& p, double* a, double* b) {
  a[0] = p.x[0], a[1] = p.y[0], a[2] = p.z[0];
  b[0] = p.x[1], b[1] = p.y[1], b[2] = p.z[1];
}

}  // namespace animtool
