// Polar decomposition of linear maps into a rotation after a stretch.
#include <cmath>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

// UsdSkel treats a matrix as singular below this determinant.
constexpr double SINGULAR_DETERMINANT = 1e-10;
constexpr int MAX_NEWTON_STEPS = 60;

// Computes the cofactors: the transposed inverse times the determinant. Returns the determinant.
double cofactors(const double* matrix, double* out) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const int i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      out[3 * i + j] =
          matrix[3 * i1 + j1] * matrix[3 * i2 + j2] - matrix[3 * i1 + j2] * matrix[3 * i2 + j1];
    }
  return matrix[0] * out[0] + matrix[1] * out[1] + matrix[2] * out[2];
}

double squared_norm(const double* matrix) {
  double sum = 0;
  for (int i = 0; i < 9; ++i) sum += matrix[i] * matrix[i];
  return sum;
}

// Replaces a regular matrix by its nearest orthogonal factor. Newton's iteration with the scaling
// of N. J. Higham, Computing the polar decomposition with applications, 1986.
void make_orthogonal(double* matrix) {
  for (int step = 0; step < MAX_NEWTON_STEPS; ++step) {
    double cofactor_matrix[9], squared_change = 0;
    const double determinant = cofactors(matrix, cofactor_matrix);
    const double inverse_norm = std::sqrt(squared_norm(cofactor_matrix)) / std::fabs(determinant);
    const double scale = std::sqrt(inverse_norm / std::sqrt(squared_norm(matrix)));
    for (int i = 0; i < 9; ++i) {
      const double next = 0.5 * (scale * matrix[i] + cofactor_matrix[i] / (determinant * scale));
      squared_change += (next - matrix[i]) * (next - matrix[i]);
      matrix[i] = next;
    }
    // Steps shrink quadratically, so the next one would be below the rounding error.
    if (!(squared_change > 1e-18)) return;
  }
}

void to_quaternion(const double* r, double* q) {
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

void split_map(const double* linear, double* rotation, double* stretch) {
  double orthogonal_matrix[9], cofactor_matrix[9];
  for (int i = 0; i < 9; ++i) orthogonal_matrix[i] = linear[i];
  const double determinant = cofactors(linear, cofactor_matrix);
  if (std::fabs(determinant) < SINGULAR_DETERMINANT) {
    for (int i = 0; i < 4; ++i) rotation[i] = 0;
    for (int i = 0; i < 9; ++i) stretch[i] = i % 4 == 0;
    return;
  }
  make_orthogonal(orthogonal_matrix);
  if (determinant < 0)
    for (double& value : orthogonal_matrix) value = -value;
  to_quaternion(orthogonal_matrix, rotation);
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j) {
      double upper_entry = 0, lower_entry = 0;
      for (int k = 0; k < 3; ++k) {
        upper_entry += orthogonal_matrix[3 * k + i] * linear[3 * k + j];
        lower_entry += orthogonal_matrix[3 * k + j] * linear[3 * k + i];
      }
      stretch[3 * i + j] = stretch[3 * j + i] = 0.5 * (upper_entry + lower_entry);
    }
}

}  // namespace

StretchSplit split_stretch(In<double, 4> linear) {
  const std::size_t frames = linear.shape(0), joints = linear.shape(1);
  check::shape("linear", linear, {check::ANY, check::ANY, 3, 3});
  Out<double, 3> rotations(frames, joints, 4);
  Out<double, 4> stretches(frames, joints, 3, 3);
  for (std::size_t i = 0; i < frames * joints; ++i)
    split_map(linear.data() + 9 * i, rotations.get() + 4 * i, stretches.get() + 9 * i);
  return {std::move(rotations), std::move(stretches)};
}

}  // namespace animtool
