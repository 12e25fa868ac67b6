// Blend-shape weights of a face from landmarks: bounded, robust, smooth in time.
//
// A landmark n is at R (N_n + sum_s w_s D_sn) + t. Gauss-Newton iterations linearise head pose and
// camera and eliminate the pose, which leaves a quadratic of the weights per frame; frames are
// coupled by the squares of differences between frames. The bounded problem of all frames is solved
// by coordinate descent, which finds the active bounds, and by Newton's method on the free weights,
// block-tridiagonal by Cholesky.
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

// Degrees of freedom of a pose.
constexpr std::size_t POSE_DOFS = 6;
// Sweeps of coordinate descent before a Newton step, and largest number of such steps.
constexpr int DESCENT_SWEEPS = 2, MAX_STEPS = 30;
// Halvings of a Newton step before it is skipped.
constexpr int MAX_HALVINGS = 4;
// Pose directions with less than this fraction of the largest information are unobservable.
constexpr double MIN_INFORMATION = 1e-9;

using Mat3 = std::array<double, 9>;

Mat3 rotation_matrix(const double* q) {
  Mat3 rotation_matrix;
  ik::to_matrix(q, rotation_matrix.data());
  return rotation_matrix;
}

// Multiplies a quaternion by the quaternion of a rotation vector, on the right.
void rotate_locally(double* q, const double* v) {
  const double angle = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), half = angle / 2;
  const double factor = half < 1e-4 ? 0.5 - half * half / 12 : std::sin(half) / angle;
  const double x = factor * v[0], y = factor * v[1], z = factor * v[2], w = std::cos(half);
  double product[4] = {
      q[3] * x + q[0] * w + q[1] * z - q[2] * y, q[3] * y - q[0] * z + q[1] * w + q[2] * x,
      q[3] * z + q[0] * y - q[1] * x + q[2] * w, q[3] * w - q[0] * x - q[1] * y - q[2] * z};
  const double norm = std::sqrt(product[0] * product[0] + product[1] * product[1] +
                                product[2] * product[2] + product[3] * product[3]);
  for (int i = 0; i < 4; ++i) q[i] = product[i] / norm;
}

// Factors an n × n block in place; pivots below `floor` are ignored. `column` is a buffer for n
// numbers.
void factor_block(double* a, std::size_t n, std::size_t stride, double min_pivot, double* column) {
  using namespace cholesky;
  cholesky::factor<Roots, SmallPivot::IGNORE>(a, n, stride, column,
                                              [&](std::size_t) { return min_pivot; });
}

void solve_forward(const double* l, std::size_t n, std::size_t stride, double* x,
                   std::size_t first = 0) {
  cholesky::solve_forward<cholesky::Roots>(cholesky::Rows{l, stride}, n, x, first);
}

// The cost of all frames' weights in [0, 1]: half of w' H w - g' w per frame, and squared
// differences.
struct WeightProblem {
  std::size_t frames, shapes;
  double smooth;             // weight of the squared differences
  std::vector<double> h, g;  // (F, S, S), (F, S)
  std::vector<double> low, top;

  WeightProblem(std::size_t f, std::size_t s, double smoothing)
      : frames(f),
        shapes(s),
        smooth(smoothing),
        h(f * s * s),
        g(f * s),
        factors_(f * s * s),
        step_(f * s),
        free_(f * s),
        counts_(f),
        solutions_(f * s),
        columns_(s * s) {}

  // Diagonal of the coupling with neighbouring frames.
  double coupling_weight(std::size_t f) const {
    return smooth * static_cast<double>((f > 0) + (f + 1 < frames));
  }

  // Weighted sum of the same weight in neighbouring frames.
  double neighbour_sum(const double* w, std::size_t f, std::size_t s) const {
    return smooth * ((f > 0 ? w[(f - 1) * shapes + s] : 0.0) +
                     (f + 1 < frames ? w[(f + 1) * shapes + s] : 0.0));
  }

  // Gradient of the cost by a frame's weights.
  void compute_gradient(const double* w, std::size_t f, double* out) const {
    const double* hf = h.data() + f * shapes * shapes;
    const double* wf = w + f * shapes;
    const double weight = coupling_weight(f);
    for (std::size_t s = 0; s < shapes; ++s)
      out[s] = weight * wf[s] - g[f * shapes + s] - neighbour_sum(w, f, s);
    for (std::size_t k = 0; k < shapes; ++k) {
      if (wf[k] == 0) continue;
      const double weight_k = wf[k];
      const double* row = hf + k * shapes;
      for (std::size_t s = 0; s < shapes; ++s) out[s] += weight_k * row[s];
    }
  }

  // Cost of all frames.
  double total_cost(const double* w) {
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

  // One sweep of coordinate descent over the frames, forwards or backwards; returns the largest
  // change.
  double sweep(double* w, bool backwards) {
    double max_change = 0;
    std::vector<double> gradient(shapes);
    for (std::size_t i = 0; i < frames; ++i) {
      const std::size_t f = backwards ? frames - 1 - i : i;
      double* wf = w + f * shapes;
      const double* hf = h.data() + f * shapes * shapes;
      const double coupling = coupling_weight(f);
      compute_gradient(w, f, gradient.data());
      for (std::size_t s = 0; s < shapes; ++s) {
        const double curvature = hf[s * shapes + s] + coupling;
        if (!(curvature > 0)) continue;
        const double weight = std::clamp(wf[s] - gradient[s] / curvature, 0.0, 1.0);
        const double change = weight - wf[s];
        if (change == 0) continue;
        wf[s] = weight;
        max_change = std::max(max_change, std::fabs(change));
        for (std::size_t k = 0; k < shapes; ++k) gradient[k] += change * hf[s * shapes + k];
        gradient[s] += change * coupling;
      }
    }
    return max_change;
  }

  // Computes `step_`, after which the gradient is zero at free weights; weights at their bounds are
  // fixed.
  void compute_newton_step(const double* w) {
    std::vector<double> gradient(shapes), right_hand_side(shapes), pivots(shapes);
    std::vector<std::size_t> slots(shapes, shapes), previous_index(shapes, shapes);
    for (std::size_t f = 0; f < frames; ++f) {
      const double* hf = h.data() + f * shapes * shapes;
      std::size_t* free_shapes = free_.data() + f * shapes;
      double* l = factors_.data() + f * shapes * shapes;
      compute_gradient(w, f, gradient.data());
      std::size_t n = 0;
      for (std::size_t s = 0; s < shapes; ++s) {
        const double weight = w[f * shapes + s];
        const bool is_bound =
            (weight <= 0 && gradient[s] >= 0) || (weight >= 1 && gradient[s] <= 0);
        if (!is_bound && hf[s * shapes + s] + coupling_weight(f) > 0) free_shapes[n++] = s;
      }
      counts_[f] = n;
      double trace = 0;
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j <= i; ++j)
          l[i * shapes + j] = hf[free_shapes[i] * shapes + free_shapes[j]];
        l[i * shapes + i] += coupling_weight(f);
        trace = std::max(trace, l[i * shapes + i]);
        right_hand_side[i] = -gradient[free_shapes[i]];
      }
      if (f > 0 && smooth > 0) {
        const std::size_t m = counts_[f - 1];
        const double* previous_factor = factors_.data() + (f - 1) * shapes * shapes;
        const double* previous = solutions_.data() + (f - 1) * shapes;
        std::fill(previous_index.begin(), previous_index.end(), shapes);
        for (std::size_t i = 0; i < m; ++i) previous_index[free_[(f - 1) * shapes + i]] = i;
        for (std::size_t i = 0; i < n; ++i) {
          const std::size_t weight = previous_index[free_shapes[i]];
          double* column = columns_.data() + i * shapes;
          if (weight == shapes) continue;
          std::fill(column, column + m, 0.0);
          column[weight] = smooth;
          solve_forward(previous_factor, m, shapes, column, weight);
          double sum = 0;
          for (std::size_t k = weight; k < m; ++k) sum += column[k] * previous[k];
          right_hand_side[i] += sum;
          for (std::size_t j = 0; j <= i; ++j) {
            const std::size_t other_start = previous_index[free_shapes[j]];
            if (other_start == shapes) continue;
            const double* other_column = columns_.data() + j * shapes;
            double dot = 0;
            for (std::size_t k = std::max(weight, other_start); k < m; ++k)
              dot += column[k] * other_column[k];
            l[i * shapes + j] -= dot;
          }
        }
      }
      factor_block(l, n, shapes, 1e-14 * trace, pivots.data());
      solve_forward(l, n, shapes, right_hand_side.data());
      std::copy(right_hand_side.begin(), right_hand_side.begin() + static_cast<std::ptrdiff_t>(n),
                solutions_.begin() + static_cast<std::ptrdiff_t>(f * shapes));
    }
    std::fill(step_.begin(), step_.end(), 0.0);
    for (std::size_t f = frames; f-- > 0;) {
      const std::size_t n = counts_[f];
      const std::size_t* free_shapes = free_.data() + f * shapes;
      const double* l = factors_.data() + f * shapes * shapes;
      double* x = solutions_.data() + f * shapes;
      if (f + 1 < frames && smooth > 0) {
        std::fill(right_hand_side.begin(), right_hand_side.end(), 0.0);
        for (std::size_t i = 0; i < n; ++i)
          right_hand_side[i] = smooth * step_[(f + 1) * shapes + free_shapes[i]];
        solve_forward(l, n, shapes, right_hand_side.data());
        for (std::size_t i = 0; i < n; ++i) x[i] += right_hand_side[i];
      }
      cholesky::solve_backward<cholesky::Roots>(cholesky::Rows{l, shapes}, n, x);
      for (std::size_t i = 0; i < n; ++i) step_[f * shapes + free_shapes[i]] = x[i];
    }
  }

  // Cost of a frame's weights, with those of neighbouring frames fixed.
  double frame_cost(const double* w, const double* frame_weights, std::size_t f) const {
    const double* hf = h.data() + f * shapes * shapes;
    double sum = 0;
    for (std::size_t s = 0; s < shapes; ++s) {
      if (frame_weights[s] == 0) continue;
      double row =
          0.5 * coupling_weight(f) * frame_weights[s] - g[f * shapes + s] - neighbour_sum(w, f, s);
      const double* hs = hf + s * shapes;
      for (std::size_t k = 0; k < shapes; ++k) row += 0.5 * hs[k] * frame_weights[k];
      sum += frame_weights[s] * row;
    }
    return sum;
  }

  // Moves a frame along its step, shortened until the cost falls.
  void apply_frame_step(double* w, std::size_t f, double* candidate) const {
    double *weights = w + f * shapes, fraction = 1;
    const double* step = step_.data() + f * shapes;
    const double start_cost = frame_cost(w, weights, f);
    for (int halving = 0; halving < MAX_HALVINGS; ++halving, fraction /= 2) {
      for (std::size_t s = 0; s < shapes; ++s)
        candidate[s] = std::clamp(weights[s] + fraction * step[s], 0.0, 1.0);
      if (frame_cost(w, candidate, f) < start_cost) {
        std::copy(candidate, candidate + shapes, weights);
        return;
      }
    }
  }

  // Minimises the cost over the weights, until a descent sweep changes them by less than
  // `tolerance`; returns the last change.
  double solve(double* w, double tolerance) {
    std::vector<double> candidate(frames * shapes);
    double change = 0;
    for (int step = 0; step < MAX_STEPS; ++step) {
      change = 0;
      for (int i = 0; i < DESCENT_SWEEPS; ++i) change = sweep(w, i % 2);
      if (change < tolerance) break;
      const double start_cost = total_cost(w);
      compute_newton_step(w);
      for (std::size_t i = 0; i < candidate.size(); ++i)
        candidate[i] = std::clamp(w[i] + step_[i], 0.0, 1.0);
      if (total_cost(candidate.data()) < start_cost)
        std::copy(candidate.begin(), candidate.end(), w);
      else
        for (std::size_t f = 0; f < frames; ++f) apply_frame_step(w, f, candidate.data());
    }
    return change;
  }

 private:
  std::vector<double> factors_, step_;
  std::vector<std::size_t> free_;
  std::vector<std::size_t> counts_;
  std::vector<double> solutions_, columns_;
};

// The blend shapes of a face.
struct Face {
  std::size_t landmarks, shapes;
  const double *neutral, *deltas;      // (N, 3), (S, N, 3)
  const double* camera;                // fx, fy, cx, cy; null for landmarks in three dimensions
  std::vector<double> rows_of_deltas;  // (N, 3, S): the three rows of each landmark
  std::vector<double> gram;            // (S, S): sum over all rows, with weights of 1

  void prepare() {
    rows_of_deltas.resize(landmarks * 3 * shapes);
    for (std::size_t s = 0; s < shapes; ++s)
      for (std::size_t i = 0; i < 3 * landmarks; ++i)
        rows_of_deltas[i * shapes + s] = deltas[s * 3 * landmarks + i];
    gram.assign(shapes * shapes, 0.0);
    for (std::size_t i = 0; i < 3 * landmarks; ++i)
      add_outer_product(gram.data(), 1, &rows_of_deltas[i * shapes], &rows_of_deltas[i * shapes]);
  }

  // Adds a scaled outer product to a matrix (S, S).
  void add_outer_product(double* h, double scale, const double* a, const double* b) const {
    for (std::size_t s = 0; s < shapes; ++s) {
      const double scaled = scale * a[s];
      if (scaled == 0) continue;
      for (std::size_t k = 0; k < shapes; ++k) h[s * shapes + k] += scaled * b[k];
    }
  }

  // Computes landmarks with weights, in the frame of the face (N, 3).
  void deform(const double* w, double* out) const {
    std::copy(neutral, neutral + 3 * landmarks, out);
    for (std::size_t s = 0; s < shapes; ++s) {
      if (w[s] == 0) continue;
      const double* d = deltas + s * 3 * landmarks;
      for (std::size_t i = 0; i < 3 * landmarks; ++i) out[i] += w[s] * d[i];
    }
  }
};

// Linearises one frame at its current weights and pose.
class LinearizedFrame {
 public:
  explicit LinearizedFrame(const Face& face)
      : face_(face), points_(3 * face.landmarks), cross_(face.shapes * POSE_DOFS) {}

  // Computes the lengths of residuals (N,) and robust weights of observed landmarks; returns the
  // loss.
  double compute_residuals(const double* observed, const double* w, const double* pose,
                           double threshold, double power, double* lengths,
                           double* robust_weights) {
    face_.deform(w, points_.data());
    const Mat3 r = rotation_matrix(pose);
    const std::size_t width = face_.camera ? 2 : 3;
    double loss = 0;
    for (std::size_t n = 0; n < face_.landmarks; ++n) {
      const double* pixel = observed + n * width;
      double residual[3];
      if (!compute_residual(pixel, &points_[3 * n], r, pose + 4, residual)) {
        lengths[n] = NAN, robust_weights[n] = 0;
        continue;
      }
      double sum = 0;
      for (std::size_t k = 0; k < width; ++k) sum += residual[k] * residual[k];
      lengths[n] = std::sqrt(sum);
      robust_weights[n] = lengths[n] <= threshold ? 1 : std::pow(threshold / lengths[n], power);
      loss += robust_weights[n] * sum;
    }
    return loss;
  }

  // Computes the quadratic of the weights, with the pose eliminated.
  void linearize(const double* observed, const double* w, const double* pose,
                 const double* robust_weights, double* h, double* g) {
    const std::size_t shapes = face_.shapes, landmarks = face_.landmarks;
    const Mat3 r = rotation_matrix(pose);
    face_.deform(w, points_.data());
    std::fill(g, g + shapes, 0.0);
    std::fill(cross_.begin(), cross_.end(), 0.0);
    std::fill(pose_hessian_, pose_hessian_ + POSE_DOFS * POSE_DOFS, 0.0);
    std::fill(pose_gradient_, pose_gradient_ + POSE_DOFS, 0.0);
    if (face_.camera)
      std::fill(h, h + shapes * shapes, 0.0);
    else
      std::copy(face_.gram.begin(), face_.gram.end(), h);
    for (std::size_t n = 0; n < landmarks; ++n) {
      const double* p = &points_[3 * n];
      const double* rows = &face_.rows_of_deltas[3 * n * shapes];
      const double robust_weight = robust_weights[n];
      if (!face_.camera && robust_weight != 1)
        for (int k = 0; k < 3; ++k)
          face_.add_outer_product(h, robust_weight - 1, rows + k * shapes, rows + k * shapes);
      if (robust_weight == 0) continue;
      if (!face_.camera) {
        const double* x = observed + 3 * n;
        const double d[3] = {x[0] - pose[4], x[1] - pose[5], x[2] - pose[6]};
        for (int k = 0; k < 3; ++k) {
          const double y = r[k] * d[0] + r[3 + k] * d[1] + r[6 + k] * d[2];
          double unit[3] = {0, 0, 0};
          unit[k] = 1;
          add_row(robust_weight, y - face_.neutral[3 * n + k], unit, p, rows, nullptr, g);
        }
        continue;
      }
      double residual[3], derivatives[6];
      compute_residual(observed + 2 * n, p, r, pose + 4, residual, derivatives);
      for (int k = 0; k < 2; ++k) {
        double z = residual[k];
        for (int c = 0; c < 3; ++c) z += derivatives[3 * k + c] * (p[c] - face_.neutral[3 * n + c]);
        add_row(robust_weight, z, derivatives + 3 * k, p, rows, h, g);
      }
    }
    double largest = 0;
    for (std::size_t i = 0; i < POSE_DOFS; ++i)
      largest = std::max(largest, pose_hessian_[i * POSE_DOFS + i]);
    std::copy(pose_hessian_, pose_hessian_ + POSE_DOFS * POSE_DOFS, factor_);
    double pivots[POSE_DOFS];
    factor_block(factor_, POSE_DOFS, POSE_DOFS, MIN_INFORMATION * largest, pivots);
    if (largest == 0) return;
    // H - C P^-1 C' by the rows of L^-1 C'.
    std::vector<double>& coupling = coupling_;
    coupling.resize(POSE_DOFS * shapes);
    double right_hand_side[POSE_DOFS];
    std::copy(pose_gradient_, pose_gradient_ + POSE_DOFS, right_hand_side);
    solve_forward(factor_, POSE_DOFS, POSE_DOFS, right_hand_side);
    for (std::size_t s = 0; s < shapes; ++s) {
      double column[POSE_DOFS];
      for (std::size_t i = 0; i < POSE_DOFS; ++i) column[i] = cross_[i * shapes + s];
      solve_forward(factor_, POSE_DOFS, POSE_DOFS, column);
      for (std::size_t i = 0; i < POSE_DOFS; ++i) {
        coupling[i * shapes + s] = column[i];
        g[s] -= column[i] * right_hand_side[i];
      }
    }
    for (std::size_t i = 0; i < POSE_DOFS; ++i)
      face_.add_outer_product(h, -1, &coupling[i * shapes], &coupling[i * shapes]);
    std::copy(right_hand_side, right_hand_side + POSE_DOFS, right_hand_side_);
  }

  // Updates the pose for new weights. Call it after `linearize` of the same frame.
  void update_pose(const double* w, double* pose) const {
    double step[POSE_DOFS];
    for (std::size_t i = 0; i < POSE_DOFS; ++i) {
      double sum = right_hand_side_[i];
      for (std::size_t s = 0; s < face_.shapes; ++s) sum -= coupling_[i * face_.shapes + s] * w[s];
      step[i] = sum;
    }
    cholesky::solve_backward<cholesky::Roots>(cholesky::Rows{factor_, POSE_DOFS}, POSE_DOFS, step);
    apply_pose_step(step, pose);
  }

  // Stores and restores the data of a frame that `update_pose` needs.
  static std::size_t stored_size(std::size_t shapes) {
    return POSE_DOFS * shapes + POSE_DOFS + POSE_DOFS * POSE_DOFS;
  }
  void store(double* out) {
    coupling_.resize(POSE_DOFS * face_.shapes);
    out = std::copy(coupling_.begin(), coupling_.end(), out);
    out = std::copy(right_hand_side_, right_hand_side_ + POSE_DOFS, out);
    std::copy(factor_, factor_ + POSE_DOFS * POSE_DOFS, out);
  }
  void restore(const double* in) {
    coupling_.resize(POSE_DOFS * face_.shapes);
    std::copy(in, in + POSE_DOFS * face_.shapes, coupling_.begin());
    in += POSE_DOFS * face_.shapes;
    std::copy(in, in + POSE_DOFS, right_hand_side_);
    std::copy(in + POSE_DOFS, in + POSE_DOFS + POSE_DOFS * POSE_DOFS, factor_);
  }

 private:
  // x = R (p + rotate × p + shift) + t, with the shift in the frame of the face.
  static void apply_pose_step(const double* step, double* pose) {
    const Mat3 r = rotation_matrix(pose);
    for (int i = 0; i < 3; ++i)
      pose[4 + i] += r[3 * i] * step[3] + r[3 * i + 1] * step[4] + r[3 * i + 2] * step[5];
    rotate_locally(pose, step);
  }

  // Computes the residual of an observation, and its derivatives along the axes of the face (2, 3).
  bool compute_residual(const double* pixel, const double* p, const Mat3& r, const double* t,
                        double* residual, double* derivatives = nullptr) const {
    double x[3];
    for (int i = 0; i < 3; ++i)
      x[i] = r[3 * i] * p[0] + r[3 * i + 1] * p[1] + r[3 * i + 2] * p[2] + t[i];
    if (!face_.camera) {
      for (int i = 0; i < 3; ++i) residual[i] = pixel[i] - x[i];
      return std::isfinite(residual[0] + residual[1] + residual[2]);
    }
    if (!(x[2] > 0)) return false;
    for (int k = 0; k < 2; ++k) {
      const double focal = face_.camera[k], ratio = x[k] / x[2];
      residual[k] = pixel[k] - (focal * ratio + face_.camera[2 + k]);
      if (derivatives)
        for (int c = 0; c < 3; ++c)
          derivatives[3 * k + c] = focal / x[2] * (r[3 * k + c] - ratio * r[6 + c]);
    }
    return std::isfinite(residual[0] + residual[1]);
  }

  // Adds one row: the residual along a direction in the frame of the face.
  void add_row(double scale, double z, const double* axis, const double* p, const double* rows,
               double* h, double* g) {
    const std::size_t shapes = face_.shapes;
    // axis · (rotate × p) = rotate · (p × axis)
    const double pose_row[POSE_DOFS] = {p[1] * axis[2] - p[2] * axis[1],
                                        p[2] * axis[0] - p[0] * axis[2],
                                        p[0] * axis[1] - p[1] * axis[0],
                                        axis[0],
                                        axis[1],
                                        axis[2]};
    shape_row_.resize(shapes);
    for (std::size_t s = 0; s < shapes; ++s)
      shape_row_[s] =
          axis[0] * rows[s] + axis[1] * rows[shapes + s] + axis[2] * rows[2 * shapes + s];
    if (h) face_.add_outer_product(h, scale, shape_row_.data(), shape_row_.data());
    for (std::size_t s = 0; s < shapes; ++s) g[s] += scale * z * shape_row_[s];
    for (std::size_t i = 0; i < POSE_DOFS; ++i) {
      const double scaled = scale * pose_row[i];
      if (scaled == 0) continue;
      for (std::size_t s = 0; s < shapes; ++s) cross_[i * shapes + s] += scaled * shape_row_[s];
      for (std::size_t k = 0; k < POSE_DOFS; ++k)
        pose_hessian_[i * POSE_DOFS + k] += scaled * pose_row[k];
      pose_gradient_[i] += scaled * z;
    }
  }

  const Face& face_;
  std::vector<double> points_, cross_, shape_row_, coupling_;
  double pose_hessian_[POSE_DOFS * POSE_DOFS]{}, pose_gradient_[POSE_DOFS]{},
      factor_[POSE_DOFS * POSE_DOFS]{}, right_hand_side_[POSE_DOFS]{};
};

}  // namespace

FaceFit fit_face(In<double, 3> neutral, In<double, 3> deltas, In<double, 3> observed,
                 std::optional<In<double, 1>> camera, In<double, 2> poses, In<double, 2> weights,
                 double threshold, double smooth, double rest, double tolerance, int max_iterations,
                 bool warm) {
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
  WeightProblem problem(frames, shapes, smooth);
  std::copy(weights.data(), weights.data() + frames * shapes, result.get());
  std::copy(poses.data(), poses.data() + frames * 7, fitted_poses.get());
  std::vector<double> previous_weights(frames * shapes),
      frame_data(frames * LinearizedFrame::stored_size(shapes));
  double* w = result.get();
  for (std::size_t i = 0; i < frames * shapes; ++i) w[i] = std::clamp(w[i], 0.0, 1.0);
  const std::size_t neutral_stride = neutral.shape(0) == 1 ? 0 : 3 * landmarks;
  const auto update_residuals = [&](std::size_t f, double limit, double power) {
    face.neutral = neutral.data() + f * neutral_stride;
    linear.compute_residuals(observed.data() + f * landmarks * width, w + f * shapes,
                             fitted_poses.get() + 7 * f, limit, power,
                             lengths.get() + f * landmarks, robust_weights.get() + f * landmarks);
  };
  for (; iteration < max_iterations; ++iteration) {
    std::copy(w, w + frames * shapes, previous_weights.begin());
    // Starts with Huber's loss, which has one minimum; then uses a redescending one.
    const bool is_early = !warm && iteration < 3;
    const double power = is_early ? 1 : 2;
    const double limit = is_early && iteration == 0 ? HUGE_VAL : threshold;
    for (std::size_t f = 0; f < frames; ++f) {
      update_residuals(f, limit, power);
      double* h = problem.h.data() + f * shapes * shapes;
      linear.linearize(observed.data() + f * landmarks * width, w + f * shapes,
                       fitted_poses.get() + 7 * f, robust_weights.get() + f * landmarks, h,
                       problem.g.data() + f * shapes);
      linear.store(frame_data.data() + f * LinearizedFrame::stored_size(shapes));
      for (std::size_t s = 0; s < shapes; ++s) h[s * shapes + s] += rest;
    }
    problem.solve(w, is_early ? std::max(tolerance, 1e-3) : tolerance);
    for (std::size_t f = 0; f < frames; ++f) {
      linear.restore(frame_data.data() + f * LinearizedFrame::stored_size(shapes));
      linear.update_pose(w + f * shapes, fitted_poses.get() + 7 * f);
    }
    change = 0;
    for (std::size_t i = 0; i < frames * shapes; ++i)
      change = std::max(change, std::fabs(w[i] - previous_weights[i]));
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
