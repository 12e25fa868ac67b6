// Blend-shape weights of a face from landmarks: bounded, robust, smooth in time.
//
// A landmark n is at R (N_n + sum_s w_s D_sn) + t. Rounds of Gauss-Newton linearise head pose
// and camera, eliminate the pose, and leave per frame a quadratic of the weights; frames are
// coupled by the squares of differences from frame to frame. The bounded problem of a window
// is solved by coordinate descent, which finds the active bounds, and by Newton's method on
// the free weights, block-tridiagonal by Cholesky.
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "base/checks.h"
#include "base/cholesky.h"
#include "base/quaternions.h"
#include "capture/capture.h"

namespace animtool {

namespace {

constexpr std::size_t POSE = 6;
// Sweeps of coordinate descent before a Newton step, and steps per round.
constexpr int SWEEPS = 2, STEPS = 30;
// Halvings of a Newton step before descent continues without it.
constexpr int HALVINGS = 4;
// Pose directions with less than this fraction of the largest information are unobservable.
constexpr double UNOBSERVED = 1e-9;

using Mat3 = std::array<double, 9>;

Mat3 matrix(const double* q) {
  Mat3 matrix;
  ik::to_matrix(q, matrix.data());
  return matrix;
}

void rotate(double* q, const double* v) {
  const double angle = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), half = angle / 2;
  const double s = half < 1e-4 ? 0.5 - half * half / 12 : std::sin(half) / angle;
  const double x = s * v[0], y = s * v[1], z = s * v[2], w = std::cos(half);
  double product[4] = {
      q[3] * x + q[0] * w + q[1] * z - q[2] * y, q[3] * y - q[0] * z + q[1] * w + q[2] * x,
      q[3] * z + q[0] * y - q[1] * x + q[2] * w, q[3] * w - q[0] * x - q[1] * y - q[2] * z};
  const double size = std::sqrt(product[0] * product[0] + product[1] * product[1] +
                                product[2] * product[2] + product[3] * product[3]);
  for (int i = 0; i < 4; ++i) q[i] = product[i] / size;
}

// Of the n × n block in `a` with a row of `stride`; rows without a positive pivot count as
// zero. `column` has n.
void factor(double* a, std::size_t n, std::size_t stride, double floor, double* column) {
  using namespace cholesky;
  cholesky::factor<Roots, Small::IGNORE>(a, n, stride, column, [&](std::size_t) { return floor; });
}

void solve_forward(const double* l, std::size_t n, std::size_t stride, double* x,
                   std::size_t first = 0) {
  cholesky::solve_forward<cholesky::Roots>(cholesky::Rows{l, stride}, n, x, first);
}

// Cost of a frame's weights: half of w' H w - g' w, 0 to 1.
struct Quadratics {
  std::size_t frames, shapes;
  double smooth;             // of the squares of differences
  std::vector<double> h, g;  // (F, S, S), (F, S)
  std::vector<double> low, top;

  Quadratics(std::size_t f, std::size_t s, double smoothing)
      : frames(f),
        shapes(s),
        smooth(smoothing),
        h(f * s * s),
        g(f * s),
        factors_(f * s * s),
        step_(f * s),
        free_(f * s),
        counts_(f),
        kept_(f * s),
        columns_(s * s) {}

  double neighbours(std::size_t f) const {
    return smooth * static_cast<double>((f > 0) + (f + 1 < frames));
  }

  double coupling(const double* w, std::size_t f, std::size_t s) const {
    return smooth * ((f > 0 ? w[(f - 1) * shapes + s] : 0.0) +
                     (f + 1 < frames ? w[(f + 1) * shapes + s] : 0.0));
  }

  void slope(const double* w, std::size_t f, double* out) const {
    const double* hf = h.data() + f * shapes * shapes;
    const double* wf = w + f * shapes;
    const double coupled = neighbours(f);
    for (std::size_t s = 0; s < shapes; ++s)
      out[s] = coupled * wf[s] - g[f * shapes + s] - coupling(w, f, s);
    for (std::size_t k = 0; k < shapes; ++k) {
      if (wf[k] == 0) continue;
      const double by = wf[k];
      const double* row = hf + k * shapes;
      for (std::size_t s = 0; s < shapes; ++s) out[s] += by * row[s];
    }
  }

  double value(const double* w) {
    double sum = 0;
    std::vector<double>& hw = columns_;
    for (std::size_t f = 0; f < frames; ++f) {
      const double* wf = w + f * shapes;
      const double* hf = h.data() + f * shapes * shapes;
      std::fill(hw.begin(), hw.begin() + static_cast<std::ptrdiff_t>(shapes), 0.0);
      for (std::size_t k = 0; k < shapes; ++k)
        if (wf[k] != 0)
          for (std::size_t s = 0; s < shapes; ++s) hw[s] += wf[k] * hf[k * shapes + s];
      for (std::size_t s = 0; s < shapes; ++s) {
        sum += wf[s] * (0.5 * hw[s] - g[f * shapes + s]);
        if (f > 0) {
          const double d = wf[s] - wf[s - shapes];
          sum += 0.5 * smooth * d * d;
        }
      }
    }
    return sum;
  }

  // One sweep over the frames, forwards or backwards; returns the largest change.
  double sweep(double* w, bool back) {
    double most = 0;
    std::vector<double> slopes(shapes);
    for (std::size_t i = 0; i < frames; ++i) {
      const std::size_t f = back ? frames - 1 - i : i;
      double* wf = w + f * shapes;
      const double* hf = h.data() + f * shapes * shapes;
      const double coupled = neighbours(f);
      slope(w, f, slopes.data());
      for (std::size_t s = 0; s < shapes; ++s) {
        const double bend = hf[s * shapes + s] + coupled;
        if (!(bend > 0)) continue;
        const double weight = std::clamp(wf[s] - slopes[s] / bend, 0.0, 1.0);
        const double change = weight - wf[s];
        if (change == 0) continue;
        wf[s] = weight;
        most = std::max(most, std::fabs(change));
        for (std::size_t k = 0; k < shapes; ++k) slopes[k] += change * hf[s * shapes + k];
        slopes[s] += change * coupled;
      }
    }
    return most;
  }

  // The weights with zero gradient at free entries, bounds fixed: `step_`.
  void newton(const double* w) {
    std::vector<double> slopes(shapes), right(shapes), pivots(shapes);
    std::vector<std::size_t> slots(shapes, shapes), before(shapes, shapes);
    for (std::size_t f = 0; f < frames; ++f) {
      const double* hf = h.data() + f * shapes * shapes;
      std::size_t* unbound = free_.data() + f * shapes;
      double* l = factors_.data() + f * shapes * shapes;
      slope(w, f, slopes.data());
      std::size_t n = 0;
      for (std::size_t s = 0; s < shapes; ++s) {
        const double at = w[f * shapes + s];
        const bool bound = (at <= 0 && slopes[s] >= 0) || (at >= 1 && slopes[s] <= 0);
        if (!bound && hf[s * shapes + s] + neighbours(f) > 0) unbound[n++] = s;
      }
      counts_[f] = n;
      double trace = 0;
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j <= i; ++j)
          l[i * shapes + j] = hf[unbound[i] * shapes + unbound[j]];
        l[i * shapes + i] += neighbours(f);
        trace = std::max(trace, l[i * shapes + i]);
        right[i] = -slopes[unbound[i]];
      }
      if (f > 0 && smooth > 0) {
        const std::size_t m = counts_[f - 1];
        const double* lb = factors_.data() + (f - 1) * shapes * shapes;
        const double* stored = kept_.data() + (f - 1) * shapes;
        std::fill(before.begin(), before.end(), shapes);
        for (std::size_t i = 0; i < m; ++i) before[free_[(f - 1) * shapes + i]] = i;
        for (std::size_t i = 0; i < n; ++i) {
          const std::size_t at = before[unbound[i]];
          double* column = columns_.data() + i * shapes;
          if (at == shapes) continue;
          std::fill(column, column + m, 0.0);
          column[at] = smooth;
          solve_forward(lb, m, shapes, column, at);
          double sum = 0;
          for (std::size_t k = at; k < m; ++k) sum += column[k] * stored[k];
          right[i] += sum;
          for (std::size_t j = 0; j <= i; ++j) {
            const std::size_t other = before[unbound[j]];
            if (other == shapes) continue;
            const double* second = columns_.data() + j * shapes;
            double dot = 0;
            for (std::size_t k = std::max(at, other); k < m; ++k) dot += column[k] * second[k];
            l[i * shapes + j] -= dot;
          }
        }
      }
      factor(l, n, shapes, 1e-14 * trace, pivots.data());
      solve_forward(l, n, shapes, right.data());
      std::copy(right.begin(), right.begin() + static_cast<std::ptrdiff_t>(n),
                kept_.begin() + static_cast<std::ptrdiff_t>(f * shapes));
    }
    std::fill(step_.begin(), step_.end(), 0.0);
    for (std::size_t f = frames; f-- > 0;) {
      const std::size_t n = counts_[f];
      const std::size_t* unbound = free_.data() + f * shapes;
      const double* l = factors_.data() + f * shapes * shapes;
      double* x = kept_.data() + f * shapes;
      if (f + 1 < frames && smooth > 0) {
        std::fill(right.begin(), right.end(), 0.0);
        for (std::size_t i = 0; i < n; ++i)
          right[i] = smooth * step_[(f + 1) * shapes + unbound[i]];
        solve_forward(l, n, shapes, right.data());
        for (std::size_t i = 0; i < n; ++i) x[i] += right[i];
      }
      cholesky::solve_backward<cholesky::Roots>(cholesky::Rows{l, shapes}, n, x);
      for (std::size_t i = 0; i < n; ++i) step_[f * shapes + unbound[i]] = x[i];
    }
  }

  // Cost of a frame's weights for fixed neighbours.
  double cost(const double* w, const double* direction, std::size_t f) const {
    const double* hf = h.data() + f * shapes * shapes;
    double sum = 0;
    for (std::size_t s = 0; s < shapes; ++s) {
      if (direction[s] == 0) continue;
      double row = 0.5 * neighbours(f) * direction[s] - g[f * shapes + s] - coupling(w, f, s);
      const double* hs = hf + s * shapes;
      for (std::size_t k = 0; k < shapes; ++k) row += 0.5 * hs[k] * direction[k];
      sum += direction[s] * row;
    }
    return sum;
  }

  // Take the part of a frame's step that lowers its cost.
  void take_step(double* w, std::size_t f, double* candidate) const {
    double *weights = w + f * shapes, fraction = 1;
    const double* step = step_.data() + f * shapes;
    const double from = cost(w, weights, f);
    for (int half = 0; half < HALVINGS; ++half, fraction /= 2) {
      for (std::size_t s = 0; s < shapes; ++s)
        candidate[s] = std::clamp(weights[s] + fraction * step[s], 0.0, 1.0);
      if (cost(w, candidate, f) < from) {
        std::copy(candidate, candidate + shapes, weights);
        return;
      }
    }
  }

  // Minimise over weights until a descent step changes them by less than `tolerance`.
  double solve(double* w, double tolerance) {
    std::vector<double> candidate(frames * shapes);
    double change = 0;
    for (int step = 0; step < STEPS; ++step) {
      change = 0;
      for (int i = 0; i < SWEEPS; ++i) change = sweep(w, i % 2);
      if (change < tolerance) break;
      const double from = value(w);
      newton(w);
      for (std::size_t i = 0; i < candidate.size(); ++i)
        candidate[i] = std::clamp(w[i] + step_[i], 0.0, 1.0);
      if (value(candidate.data()) < from)
        std::copy(candidate.begin(), candidate.end(), w);
      else
        for (std::size_t f = 0; f < frames; ++f) take_step(w, f, candidate.data());
    }
    return change;
  }

 private:
  std::vector<double> factors_, step_;
  std::vector<std::size_t> free_;
  std::vector<std::size_t> counts_;
  std::vector<double> kept_, columns_;
};

struct Face {
  std::size_t landmarks, shapes;
  const double *neutral, *deltas;      // (N, 3), (S, N, 3)
  const double* camera;                // fx, fy, cx, cy; null for landmarks in three dimensions
  std::vector<double> deltas_of_rows;  // (N, 3, S): of a landmark its three rows
  std::vector<double> gram;            // (S, S): the sum of all, for weights of one

  void prepare() {
    deltas_of_rows.resize(landmarks * 3 * shapes);
    for (std::size_t s = 0; s < shapes; ++s)
      for (std::size_t i = 0; i < 3 * landmarks; ++i)
        deltas_of_rows[i * shapes + s] = deltas[s * 3 * landmarks + i];
    gram.assign(shapes * shapes, 0.0);
    for (std::size_t i = 0; i < 3 * landmarks; ++i)
      add(gram.data(), 1, &deltas_of_rows[i * shapes], &deltas_of_rows[i * shapes]);
  }

  void add(double* h, double by, const double* a, const double* b) const {
    for (std::size_t s = 0; s < shapes; ++s) {
      const double scaled = by * a[s];
      if (scaled == 0) continue;
      for (std::size_t k = 0; k < shapes; ++k) h[s * shapes + k] += scaled * b[k];
    }
  }

  // Landmarks at weights, in the face's frame (N, 3).
  void deformed(const double* w, double* out) const {
    std::copy(neutral, neutral + 3 * landmarks, out);
    for (std::size_t s = 0; s < shapes; ++s) {
      if (w[s] == 0) continue;
      const double* d = deltas + s * 3 * landmarks;
      for (std::size_t i = 0; i < 3 * landmarks; ++i) out[i] += w[s] * d[i];
    }
  }
};

// A frame linearised at its current state.
class LinearizedFrame {
 public:
  explicit LinearizedFrame(const Face& face)
      : face_(face), points_(3 * face.landmarks), cross_(face.shapes * POSE) {}

  // Residuals (N,) and robust weights of observed landmarks; returns the loss.
  double residuals(const double* observed, const double* w, const double* pose, double threshold,
                   double power, double* length, double* weight) {
    face_.deformed(w, points_.data());
    const Mat3 r = matrix(pose);
    const std::size_t width = face_.camera ? 2 : 3;
    double loss = 0;
    for (std::size_t n = 0; n < face_.landmarks; ++n) {
      const double* pixel = observed + n * width;
      double residual[3];
      if (!residual_of(pixel, &points_[3 * n], r, pose + 4, residual)) {
        length[n] = NAN, weight[n] = 0;
        continue;
      }
      double sum = 0;
      for (std::size_t k = 0; k < width; ++k) sum += residual[k] * residual[k];
      length[n] = std::sqrt(sum);
      weight[n] = length[n] <= threshold ? 1 : std::pow(threshold / length[n], power);
      loss += weight[n] * sum;
    }
    return loss;
  }

  // The quadratic of the weights, the pose eliminated.
  void linearize(const double* observed, const double* w, const double* pose, const double* weight,
                 double* h, double* g) {
    const std::size_t shapes = face_.shapes, landmarks = face_.landmarks;
    const Mat3 r = matrix(pose);
    face_.deformed(w, points_.data());
    std::fill(g, g + shapes, 0.0);
    std::fill(cross_.begin(), cross_.end(), 0.0);
    std::fill(pose_h_, pose_h_ + POSE * POSE, 0.0);
    std::fill(pose_g_, pose_g_ + POSE, 0.0);
    if (face_.camera)
      std::fill(h, h + shapes * shapes, 0.0);
    else
      std::copy(face_.gram.begin(), face_.gram.end(), h);
    for (std::size_t n = 0; n < landmarks; ++n) {
      const double* p = &points_[3 * n];
      const double* rows = &face_.deltas_of_rows[3 * n * shapes];
      const double by = weight[n];
      if (!face_.camera && by != 1)
        for (int k = 0; k < 3; ++k) face_.add(h, by - 1, rows + k * shapes, rows + k * shapes);
      if (by == 0) continue;
      if (!face_.camera) {
        const double* x = observed + 3 * n;
        const double d[3] = {x[0] - pose[4], x[1] - pose[5], x[2] - pose[6]};
        for (int k = 0; k < 3; ++k) {
          const double y = r[k] * d[0] + r[3 + k] * d[1] + r[6 + k] * d[2];
          double unit[3] = {0, 0, 0};
          unit[k] = 1;
          row(by, y - face_.neutral[3 * n + k], unit, p, rows, nullptr, g);
        }
        continue;
      }
      double residual[3], slopes[6];
      residual_of(observed + 2 * n, p, r, pose + 4, residual, slopes);
      for (int k = 0; k < 2; ++k) {
        double z = residual[k];
        for (int c = 0; c < 3; ++c) z += slopes[3 * k + c] * (p[c] - face_.neutral[3 * n + c]);
        row(by, z, slopes + 3 * k, p, rows, h, g);
      }
    }
    double largest = 0;
    for (std::size_t i = 0; i < POSE; ++i) largest = std::max(largest, pose_h_[i * POSE + i]);
    std::copy(pose_h_, pose_h_ + POSE * POSE, factor_);
    double pivots[POSE];
    factor(factor_, POSE, POSE, UNOBSERVED * largest, pivots);
    if (largest == 0) return;
    // H - C P^-1 C' by the rows of L^-1 C'.
    std::vector<double>& solved = solved_;
    solved.resize(POSE * shapes);
    double right[POSE];
    std::copy(pose_g_, pose_g_ + POSE, right);
    solve_forward(factor_, POSE, POSE, right);
    for (std::size_t s = 0; s < shapes; ++s) {
      double column[POSE];
      for (std::size_t i = 0; i < POSE; ++i) column[i] = cross_[i * shapes + s];
      solve_forward(factor_, POSE, POSE, column);
      for (std::size_t i = 0; i < POSE; ++i) {
        solved[i * shapes + s] = column[i];
        g[s] -= column[i] * right[i];
      }
    }
    for (std::size_t i = 0; i < POSE; ++i)
      face_.add(h, -1, &solved[i * shapes], &solved[i * shapes]);
    std::copy(right, right + POSE, right_);
  }

  // Update the pose for solved weights. Call after the same `linearize`.
  void update_pose(const double* w, double* pose) const {
    double step[POSE];
    for (std::size_t i = 0; i < POSE; ++i) {
      double sum = right_[i];
      for (std::size_t s = 0; s < face_.shapes; ++s) sum -= solved_[i * face_.shapes + s] * w[s];
      step[i] = sum;
    }
    cholesky::solve_backward<cholesky::Roots>(cholesky::Rows{factor_, POSE}, POSE, step);
    apply_pose_step(step, pose);
  }

  // The data of a frame that `update_pose` needs.
  static std::size_t stored_size(std::size_t shapes) { return POSE * shapes + POSE + POSE * POSE; }
  void store(double* out) {
    solved_.resize(POSE * face_.shapes);
    out = std::copy(solved_.begin(), solved_.end(), out);
    out = std::copy(right_, right_ + POSE, out);
    std::copy(factor_, factor_ + POSE * POSE, out);
  }
  void restore(const double* in) {
    solved_.resize(POSE * face_.shapes);
    std::copy(in, in + POSE * face_.shapes, solved_.begin());
    in += POSE * face_.shapes;
    std::copy(in, in + POSE, right_);
    std::copy(in + POSE, in + POSE + POSE * POSE, factor_);
  }

 private:
  // x = R (p + rotate × p + shift) + t: the shift is in the frame of the face.
  static void apply_pose_step(const double* step, double* pose) {
    const Mat3 r = matrix(pose);
    for (int i = 0; i < 3; ++i)
      pose[4 + i] += r[3 * i] * step[3] + r[3 * i + 1] * step[4] + r[3 * i + 2] * step[5];
    rotate(pose, step);
  }

  // Residual of an observation, and its derivatives along the face's axes (2, 3).
  bool residual_of(const double* pixel, const double* p, const Mat3& r, const double* t,
                   double* residual, double* slopes = nullptr) const {
    double x[3];
    for (int i = 0; i < 3; ++i)
      x[i] = r[3 * i] * p[0] + r[3 * i + 1] * p[1] + r[3 * i + 2] * p[2] + t[i];
    if (!face_.camera) {
      for (int i = 0; i < 3; ++i) residual[i] = pixel[i] - x[i];
      return std::isfinite(residual[0] + residual[1] + residual[2]);
    }
    if (!(x[2] > 0)) return false;
    for (int k = 0; k < 2; ++k) {
      const double focal = face_.camera[k], at = x[k] / x[2];
      residual[k] = pixel[k] - (focal * at + face_.camera[2 + k]);
      if (slopes)
        for (int c = 0; c < 3; ++c)
          slopes[3 * k + c] = focal / x[2] * (r[3 * k + c] - at * r[6 + c]);
    }
    return std::isfinite(residual[0] + residual[1]);
  }

  // One row: the residual along a direction of the face's frame.
  void row(double by, double z, const double* axis, const double* p, const double* rows, double* h,
           double* g) {
    const std::size_t shapes = face_.shapes;
    // axis · (rotate × p) = rotate · (p × axis)
    const double pose[POSE] = {p[1] * axis[2] - p[2] * axis[1],
                               p[2] * axis[0] - p[0] * axis[2],
                               p[0] * axis[1] - p[1] * axis[0],
                               axis[0],
                               axis[1],
                               axis[2]};
    line_.resize(shapes);
    for (std::size_t s = 0; s < shapes; ++s)
      line_[s] = axis[0] * rows[s] + axis[1] * rows[shapes + s] + axis[2] * rows[2 * shapes + s];
    if (h) face_.add(h, by, line_.data(), line_.data());
    for (std::size_t s = 0; s < shapes; ++s) g[s] += by * z * line_[s];
    for (std::size_t i = 0; i < POSE; ++i) {
      const double scaled = by * pose[i];
      if (scaled == 0) continue;
      for (std::size_t s = 0; s < shapes; ++s) cross_[i * shapes + s] += scaled * line_[s];
      for (std::size_t k = 0; k < POSE; ++k) pose_h_[i * POSE + k] += scaled * pose[k];
      pose_g_[i] += scaled * z;
    }
  }

  const Face& face_;
  std::vector<double> points_, cross_, line_, solved_;
  double pose_h_[POSE * POSE]{}, pose_g_[POSE]{}, factor_[POSE * POSE]{}, right_[POSE]{};
};

}  // namespace

FittedFace fit_face(In<double, 3> neutral, In<double, 3> deltas, In<double, 3> observed,
                    std::optional<In<double, 1>> camera, In<double, 2> poses, In<double, 2> weights,
                    double threshold, double smooth, double rest, double tolerance,
                    int max_iterations, bool warm) {
  const std::size_t landmarks = neutral.shape(1), shapes = deltas.shape(0),
                    frames = observed.shape(0);
  const std::size_t width = camera ? 2 : 3;
  check::at_most("observed", frames * landmarks, check::MAX_ROWS);
  check::at_most("deltas", shapes * landmarks, check::MAX_ROWS);
  check::at_most("weights", frames * shapes * std::max<std::size_t>(shapes, 1), check::MAX_ROWS);
  check::shape("neutral", neutral, {neutral.shape(0) == 1 ? 1 : frames, landmarks, 3});
  check::shape("deltas", deltas, {shapes, landmarks, 3});
  check::shape("observed", observed, {frames, landmarks, width});
  check::shape("poses", poses, {frames, 7});
  check::shape("weights", weights, {frames, shapes});
  check::finite("neutral", neutral);
  check::finite("deltas", deltas);
  check::finite("poses", poses);
  check::finite("weights", weights);
  check::positive("threshold", threshold);
  check::not_negative("smooth", smooth);
  check::not_negative("rest", rest);
  check::positive("tolerance", tolerance);
  check::between("max_iterations", max_iterations, 1, 1000);
  if (camera) {
    check::numbers("camera", *camera, {4});
    check::positive("camera", camera->data()[0]);
    check::positive("camera", camera->data()[1]);
  }
  Out<double, 2> result(frames, shapes), fitted_poses(frames, 7), lengths(frames, landmarks),
      robust_weights(frames, landmarks);
  int iteration = 0;
  double change = 0;
  Face face{landmarks, shapes, neutral.data(), deltas.data(), camera ? camera->data() : nullptr,
            {},        {}};
  face.prepare();
  LinearizedFrame linear(face);
  Quadratics problem(frames, shapes, smooth);
  std::copy(weights.data(), weights.data() + frames * shapes, result.get());
  std::copy(poses.data(), poses.data() + frames * 7, fitted_poses.get());
  std::vector<double> before(frames * shapes),
      stored(frames * LinearizedFrame::stored_size(shapes));
  double* w = result.get();
  for (std::size_t i = 0; i < frames * shapes; ++i) w[i] = std::clamp(w[i], 0.0, 1.0);
  const std::size_t each = neutral.shape(0) == 1 ? 0 : 3 * landmarks;
  const auto update_residuals = [&](std::size_t f, double limit, double power) {
    face.neutral = neutral.data() + f * each;
    linear.residuals(observed.data() + f * landmarks * width, w + f * shapes,
                     fitted_poses.get() + 7 * f, limit, power, lengths.get() + f * landmarks,
                     robust_weights.get() + f * landmarks);
  };
  for (; iteration < max_iterations; ++iteration) {
    std::copy(w, w + frames * shapes, before.begin());
    // Huber's loss first, which has one minimum; then a redescending one.
    const bool is_early = !warm && iteration < 3;
    const double power = is_early ? 1 : 2;
    const double limit = is_early && iteration == 0 ? HUGE_VAL : threshold;
    for (std::size_t f = 0; f < frames; ++f) {
      update_residuals(f, limit, power);
      double* h = problem.h.data() + f * shapes * shapes;
      linear.linearize(observed.data() + f * landmarks * width, w + f * shapes,
                       fitted_poses.get() + 7 * f, robust_weights.get() + f * landmarks, h,
                       problem.g.data() + f * shapes);
      linear.store(stored.data() + f * LinearizedFrame::stored_size(shapes));
      for (std::size_t s = 0; s < shapes; ++s) h[s * shapes + s] += rest;
    }
    problem.solve(w, is_early ? std::max(tolerance, 1e-3) : tolerance);
    for (std::size_t f = 0; f < frames; ++f) {
      linear.restore(stored.data() + f * LinearizedFrame::stored_size(shapes));
      linear.update_pose(w + f * shapes, fitted_poses.get() + 7 * f);
    }
    change = 0;
    for (std::size_t i = 0; i < frames * shapes; ++i)
      change = std::max(change, std::fabs(w[i] - before[i]));
    if (iteration >= (warm ? 1 : 4) && change < 10 * tolerance) {
      ++iteration;
      break;
    }
  }
  for (std::size_t f = 0; f < frames; ++f) update_residuals(f, threshold, 2);
  return {std::move(result),  std::move(fitted_poses),
          std::move(lengths), std::move(robust_weights),
          iteration,          change};
}

}  // namespace animtool
