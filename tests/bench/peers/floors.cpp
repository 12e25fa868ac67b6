// The work of animtool's kernels as plain loops into arrays that the caller keeps: floors.
#include <cmath>
#include <cstdint>

using Index = std::int64_t;

extern "C" {

// Forward kinematics.
void forward(const Index* parents, Index joints, Index frames, const double* translations,
             const double* rotations, double* positions, double* linear) {
  for (Index f = 0; f < frames; ++f) {
    for (Index j = 0; j < joints; ++j) {
      const Index at = f * joints + j;
      const double* t = translations + 3 * at;
      const double x = rotations[4 * at], y = rotations[4 * at + 1];
      const double z = rotations[4 * at + 2], w = rotations[4 * at + 3];
      const double r[3][3] = {
          {1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
          {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
          {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
      const double still[12] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
      const Index above = f * joints + parents[j];
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

// Straight curves at ascending times, `width` of them with keys at one time: the segment is
// found once for all of these. A curve's values lie one after another.
void lerp(const double* key_times, const double* keys, Index joints, Index width, Index count,
          const double* times, Index frames, double* values) {
  for (Index j = 0; j < joints; ++j) {
    const double* k = key_times + j * width * count;
    Index i = 0;
    for (Index f = 0; f < frames; ++f) {
      const double t = times[f] < k[0] ? k[0] : times[f] > k[count - 1] ? k[count - 1] : times[f];
      while (i + 2 < count && t >= k[i + 1]) ++i;
      const double u = (t - k[i]) / (k[i + 1] - k[i]);
      for (Index d = 0; d < width; ++d) {
        const double* v = keys + (j * width + d) * count + i;
        values[(j * width + d) * frames + f] = v[0] + u * (v[1] - v[0]);
      }
    }
  }
}

static double bernstein(double a, double b, double c, double d, double u) {
  const double v = 1 - u;
  return v * v * (v * a + 3 * u * b) + u * u * (3 * v * c + u * d);
}

// Bezier channels at ascending times. A key is a row of six: its handle before, itself, and
// its handle behind, as (time, value). Newton's method in a bracket, from where a straight
// line would be.
void curves(const double* keys, Index channels, Index count, const double* times, Index frames,
            double* values) {
  for (Index c = 0; c < channels; ++c) {
    const double* k = keys + 6 * count * c;
    const double* last = k + 6 * (count - 2);
    for (Index f = 0; f < frames; ++f) {
      const double t = times[f];
      while (k < last && t >= k[8]) k += 6;
      const double span = k[8] - k[2];
      // Times as shares of the segment: 0, a, b and 1.
      const double x = (t - k[2]) / span, a = (k[4] - k[2]) / span, b = (k[6] - k[2]) / span;
      double low = 0, high = 1, u = x;
      for (int i = 0; i < 100; ++i) {
        const double v = 1 - u;
        const double off = u * (3 * v * (v * a + u * b) + u * u) - x;
        const double slope = 3 * (v * v * a + 2 * u * v * (b - a) + u * u * (1 - b));
        (off < 0 ? low : high) = u;
        double next = u - off / slope;
        if (!(next >= low && next <= high)) next = 0.5 * (low + high);
        const double step = next - u;
        u = next;
        if (std::fabs(step) <= 1e-15) break;
      }
      values[c * frames + f] = bernstein(k[3], k[5], k[7], k[9], u);
    }
  }
}

// Semi-implicit Euler of springs, places `(frames + 1, N, 3)`; `forces` is scratch.
void springs(Index particles, const double* start, const double* inverse_masses, Index count,
             const Index* ends, const double* rest, const double* stiffness,
             const double* damping, double drag, double step, Index steps, Index frames,
             double* velocities, double* forces, double* places) {
  const Index size = 3 * particles;
  for (Index i = 0; i < size; ++i) places[i] = start[i], velocities[i] = forces[i] = 0;
  for (Index f = 0; f < frames; ++f, places += size) {
    double* x = places + size;
    for (Index i = 0; i < size; ++i) x[i] = places[i];
    for (Index n = 0; n < steps; ++n) {
      for (Index s = 0; s < count; ++s) {
        const Index i = 3 * ends[2 * s], j = 3 * ends[2 * s + 1];
        double d[3], square = 0, rate = 0;
        for (int k = 0; k < 3; ++k) d[k] = x[j + k] - x[i + k], square += d[k] * d[k];
        const double length = std::sqrt(square);
        for (int k = 0; k < 3; ++k) rate += d[k] * (velocities[j + k] - velocities[i + k]);
        const double pull = stiffness[s] * (length - rest[s]) + damping[s] * rate / length;
        for (int k = 0; k < 3; ++k) {
          const double part = pull / length * d[k];
          forces[i + k] += part;
          forces[j + k] -= part;
        }
      }
      for (Index p = 0; p < particles; ++p) {
        for (int k = 0; k < 3; ++k) {
          double &v = velocities[3 * p + k], &force = forces[3 * p + k];
          if (inverse_masses[p] > 0) {
            v += step * (force * inverse_masses[p] - (k == 2 ? 9.81 : 0) - drag * v);
            x[3 * p + k] += step * v;
          }
          force = 0;
        }
      }
    }
  }
}

// Points under linear blend skinning; matrices `(F, J, 3, 4)` take points from their bind.
void skin(const double* points, Index vertices, const Index* joints, const double* weights,
          Index influences, const double* matrices, Index all, Index frames, double* out) {
  for (Index f = 0; f < frames; ++f, matrices += 12 * all) {
    for (Index v = 0; v < vertices; ++v, out += 3) {
      double m[12] = {};
      for (Index i = 0; i < influences; ++i) {
        const double* one = matrices + 12 * joints[v * influences + i];
        const double weight = weights[v * influences + i];
        for (int k = 0; k < 12; ++k) m[k] += weight * one[k];
      }
      const double* p = points + 3 * v;
      for (int r = 0; r < 3; ++r)
        out[r] = m[4 * r] * p[0] + m[4 * r + 1] * p[1] + m[4 * r + 2] * p[2] + m[4 * r + 3];
    }
  }
}

// Points under shapes, each with its vertices `indices[first[s]:first[s + 1]]`.
void shapes(const double* points, Index vertices, const double* weights, Index count,
            const Index* first, const Index* indices, const double* offsets, Index frames,
            double* out) {
  for (Index f = 0; f < frames; ++f, out += 3 * vertices) {
    for (Index i = 0; i < 3 * vertices; ++i) out[i] = points[i];
    for (Index s = 0; s < count; ++s) {
      const double weight = weights[f * count + s];
      for (Index i = first[s]; i < first[s + 1]; ++i)
        for (int k = 0; k < 3; ++k) out[3 * indices[i] + k] += weight * offsets[3 * i + k];
    }
  }
}

}  // extern "C"
