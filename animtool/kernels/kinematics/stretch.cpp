// Polar decomposition of linear maps: a rotation after a stretch.
#include <cmath>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

// UsdSkel calls a matrix singular below this determinant.
constexpr double SINGULAR = 1e-10;
constexpr int MAX_STEPS = 60;

// Cofactors: the inverse transposed, times the determinant, which is returned.
double cofactors(const double* a, double* c) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const int i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      c[3 * i + j] = a[3 * i1 + j1] * a[3 * i2 + j2] - a[3 * i1 + j2] * a[3 * i2 + j1];
    }
  return a[0] * c[0] + a[1] * c[1] + a[2] * c[2];
}

double squared_norm(const double* a) {
  double sum = 0;
  for (int i = 0; i < 9; ++i) sum += a[i] * a[i];
  return sum;
}

// The orthogonal factor nearest to a regular matrix: Newton's iteration with the
// scaling of Higham (1986), "Computing the polar decomposition".
void polar(double* x) {
  for (int step = 0; step < MAX_STEPS; ++step) {
    double c[9], moved = 0;
    const double det = cofactors(x, c);
    const double inverse_norm = std::sqrt(squared_norm(c)) / std::fabs(det);
    const double scale = std::sqrt(inverse_norm / std::sqrt(squared_norm(x)));
    for (int i = 0; i < 9; ++i) {
      const double next = 0.5 * (scale * x[i] + c[i] / (det * scale));
      moved += (next - x[i]) * (next - x[i]);
      x[i] = next;
    }
    // Steps shrink quadratically: the next one would be below rounding.
    if (!(moved > 1e-18)) return;
  }
}

void quaternion(const double* r, double* q) {
  int i = 0;
  if (r[4] > r[0]) i = 1;
  if (r[8] > r[4 * i]) i = 2;
  if (r[0] + r[4] + r[8] > r[4 * i]) {
    const double w = std::sqrt(1 + r[0] + r[4] + r[8]);
    q[0] = (r[7] - r[5]) / (2 * w);
    q[1] = (r[2] - r[6]) / (2 * w);
    q[2] = (r[3] - r[1]) / (2 * w);
    q[3] = w / 2;
  } else {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    const double u = std::sqrt(1 + r[4 * i] - r[4 * j] - r[4 * k]);
    q[i] = u / 2;
    q[j] = (r[3 * i + j] + r[3 * j + i]) / (2 * u);
    q[k] = (r[3 * i + k] + r[3 * k + i]) / (2 * u);
    q[3] = (r[3 * k + j] - r[3 * j + k]) / (2 * u);
  }
}

void split(const double* a, double* q, double* s) {
  double x[9], c[9];
  for (int i = 0; i < 9; ++i) x[i] = a[i];
  const double det = cofactors(a, c);
  if (std::fabs(det) < SINGULAR) {
    for (int i = 0; i < 4; ++i) q[i] = 0;
    for (int i = 0; i < 9; ++i) s[i] = i % 4 == 0;
    return;
  }
  polar(x);
  if (det < 0)
    for (double& value : x) value = -value;
  quaternion(x, q);
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j) {
      double ij = 0, ji = 0;
      for (int k = 0; k < 3; ++k) {
        ij += x[3 * k + i] * a[3 * k + j];
        ji += x[3 * k + j] * a[3 * k + i];
      }
      s[3 * i + j] = s[3 * j + i] = 0.5 * (ij + ji);
    }
}

}  // namespace

Stretched split_stretch(In<double, 4> linear) {
  const std::size_t frames = linear.shape(0), joints = linear.shape(1);
  check::shape("linear", linear, {check::ANY, check::ANY, 3, 3});
  Out<double, 3> rotations(frames, joints, 4);
  Out<double, 4> stretches(frames, joints, 3, 3);
  for (std::size_t i = 0; i < frames * joints; ++i)
    split(linear.data() + 9 * i, rotations.get() + 4 * i, stretches.get() + 9 * i);
  return {std::move(rotations), std::move(stretches)};
}

}  // namespace animtool
