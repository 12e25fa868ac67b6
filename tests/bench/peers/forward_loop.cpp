// Forward kinematics as a plain loop into arrays that the caller keeps.
#include <cstdint>

extern "C" void forward_loop(const std::int64_t* parents, std::int64_t joints,
                             std::int64_t frames, const double* translations,
                             const double* rotations, double* positions, double* linear) {
  for (std::int64_t f = 0; f < frames; ++f) {
    for (std::int64_t j = 0; j < joints; ++j) {
      const std::int64_t at = f * joints + j;
      const double* t = translations + 3 * at;
      const double x = rotations[4 * at], y = rotations[4 * at + 1];
      const double z = rotations[4 * at + 2], w = rotations[4 * at + 3];
      const double r[3][3] = {
          {1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
          {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
          {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
      const double still[12] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
      const std::int64_t above = f * joints + parents[j];
      const double* p = parents[j] < 0 ? still : linear + 9 * above;
      const double* o = parents[j] < 0 ? still + 9 : positions + 3 * above;
      for (int i = 0; i < 3; ++i) {
        const double a = p[3 * i], b = p[3 * i + 1], c = p[3 * i + 2];
        for (int k = 0; k < 3; ++k)
          linear[9 * at + 3 * i + k] = a * r[0][k] + b * r[1][k] + c * r[2][k];
        positions[3 * at + i] = a * t[0] + b * t[1] + c * t[2] + o[i];
      }
    }
  }
}
