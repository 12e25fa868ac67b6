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
constexpr int SWEEPS_PER_STEP = 2, MAX_NEWTON_STEPS = 30;
// Halvings of a Newton step before it is skipped.
constexpr int MAX_HALVINGS = 4;
// Pose directions with less than this fraction of the largest information are unobservable.
constexpr double MIN_INFORMATION_RATIO = 1e-9;

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
  std::size_t frame_count, shape_count;
  double smoothness;                           // weight of the squared differences
  std::vector<double> hessians, linear_terms;  // (F, S, S), (F, S)
  std::vector<double> low, top;

  WeightProblem(std::size_t f, std::size_t s, double smoothing)
      : frame_count(f),
        shape_count(s),
        smoothness(smoothing),
        hessians(f * s * s),
        linear_terms(f * s),
        factors_(f * s * s),
        step_(f * s),
        free_shapes_(f * s),
        free_counts_(f),
        solutions_(f * s),
        coupling_columns_(s * s) {}

  // Diagonal of the coupling with neighbouring frames.
  double coupling_weight(std::size_t f) const {
    return smoothness * static_cast<double>((f > 0) + (f + 1 < frame_count));
  }

  // Weighted sum of the same weight in neighbouring frames.
  double neighbour_sum(const double* w, std::size_t f, std::size_t s) const {
    return smoothness * ((f > 0 ? w[(f - 1) * shape_count + s] : 0.0) +
                         (f + 1 < frame_count ? w[(f + 1) * shape_count + s] : 0.0));
  }

  // Gradient of the cost by a frame's weights.
  void compute_gradient(const double* w, std::size_t f, double* out) const {
    const double* hf = hessians.data() + f * shape_count * shape_count;
    const double* wf = w + f * shape_count;
    const double weight = coupling_weight(f);
    for (std::size_t s = 0; s < shape_count; ++s)
      out[s] = weight * wf[s] - linear_terms[f * shape_count + s] - neighbour_sum(w, f, s);
    for (std::size_t k = 0; k < shape_count; ++k) {
      if (wf[k] == 0) continue;
      const double weight_k = wf[k];
      const double* row = hf + k * shape_count;
      for (std::size_t s = 0; s < shape_count; ++s) out[s] += weight_k * row[s];
    }
  }

  // Cost of all frames.
  double total_cost(const double* w) {
    double sum = 0;
    std::vector<double>& hw = coupling_columns_;
    for (std::size_t f = 0; f < frame_count; ++f) {
      const double* wf = w + f * shape_count;
      const double* hf = hessians.data() + f * shape_count * shape_count;
      std::fill(hw.begin(), hw.begin() + static_cast<std::ptrdiff_t>(shape_count), 0.0);
      for (std::size_t k = 0; k < shape_count; ++k)
        if (wf[k] != 0)
          for (std::size_t s = 0; s < shape_count; ++s) hw[s] += wf[k] * hf[k * shape_count + s];
      for (std::size_t s = 0; s < shape_count; ++s) {
        sum += wf[s] * (0.5 * hw[s] - linear_terms[f * shape_count + s]);
        if (f > 0) {
          const double d = wf[s] - wf[s - shape_count];
          sum += 0.5 * smoothness * d * d;
        }
      }
    }
    return sum;
  }

  // One sweep of coordinate descent over the frames, forwards or backwards; returns the largest
  // change.
  double sweep(double* w, bool is_backwards) {
    double max_change = 0;
    std::vector<double> gradient(shape_count);
    for (std::size_t i = 0; i < frame_count; ++i) {
      const std::size_t f = is_backwards ? frame_count - 1 - i : i;
      double* wf = w + f * shape_count;
      const double* hf = hessians.data() + f * shape_count * shape_count;
      const double coupling = coupling_weight(f);
      compute_gradient(w, f, gradient.data());
      for (std::size_t s = 0; s < shape_count; ++s) {
        const double curvature = hf[s * shape_count + s] + coupling;
        if (!(curvature > 0)) continue;
        const double weight = std::clamp(wf[s] - gradient[s] / curvature, 0.0, 1.0);
        const double change = weight - wf[s];
        if (change == 0) continue;
        wf[s] = weight;
        max_change = std::max(max_change, std::fabs(change));
        for (std::size_t k = 0; k < shape_count; ++k)
          gradient[k] += change * hf[s * shape_count + k];
        gradient[s] += change * coupling;
      }
    }
    return max_change;
  }

  // Computes `step_`, after which the gradient is zero at free weights; weights at their bounds are
  // fixed.
  void compute_newton_step(const double* w) {
    std::vector<double> gradient(shape_count), right_hand_side(shape_count), pivots(shape_count);
    std::vector<std::size_t> slots(shape_count, shape_count),
        previous_index(shape_count, shape_count);
    for (std::size_t f = 0; f < frame_count; ++f) {
      const double* hf = hessians.data() + f * shape_count * shape_count;
      std::size_t* free_shapes = free_shapes_.data() + f * shape_count;
      double* l = factors_.data() + f * shape_count * shape_count;
      compute_gradient(w, f, gradient.data());
      std::size_t n = 0;
      for (std::size_t s = 0; s < shape_count; ++s) {
        const double weight = w[f * shape_count + s];
        const bool is_bound =
            (weight <= 0 && gradient[s] >= 0) || (weight >= 1 && gradient[s] <= 0);
        if (!is_bound && hf[s * shape_count + s] + coupling_weight(f) > 0) free_shapes[n++] = s;
      }
      free_counts_[f] = n;
      double trace = 0;
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j <= i; ++j)
          l[i * shape_count + j] = hf[free_shapes[i] * shape_count + free_shapes[j]];
        l[i * shape_count + i] += coupling_weight(f);
        trace = std::max(trace, l[i * shape_count + i]);
        right_hand_side[i] = -gradient[free_shapes[i]];
      }
      if (f > 0 && smoothness > 0) {
        const std::size_t m = free_counts_[f - 1];
        const double* previous_factor = factors_.data() + (f - 1) * shape_count * shape_count;
        const double* previous_solution = solutions_.data() + (f - 1) * shape_count;
        std::fill(previous_index.begin(), previous_index.end(), shape_count);
        for (std::size_t i = 0; i < m; ++i)
          previous_index[free_shapes_[(f - 1) * shape_count + i]] = i;
        for (std::size_t i = 0; i < n; ++i) {
          const std::size_t previous_slot = previous_index[free_shapes[i]];
          double* column = coupling_columns_.data() + i * shape_count;
          if (previous_slot == shape_count) continue;
          std::fill(column, column + m, 0.0);
          column[previous_slot] = smoothness;
          solve_forward(previous_factor, m, shape_count, column, previous_slot);
          double sum = 0;
          for (std::size_t k = previous_slot; k < m; ++k) sum += column[k] * previous_solution[k];
          right_hand_side[i] += sum;
          for (std::size_t j = 0; j <= i; ++j) {
            const std::size_t other_start = previous_index[free_shapes[j]];
            if (other_start == shape_count) continue;
            const double* other_column = coupling_columns_.data() + j * shape_count;
            double dot = 0;
            for (std::size_t k = std::max(previous_slot, other_start); k < m; ++k)
              dot += column[k] * other_column[k];
            l[i * shape_count + j] -= dot;
          }
        }
      }
      factor_block(l, n, shape_count, 1e-14 * trace, pivots.data());
      solve_forward(l, n, shape_count, right_hand_side.data());
      std::copy(right_hand_side.begin(), right_hand_side.begin() + static_cast<std::ptrdiff_t>(n),
                solutions_.begin() + static_cast<std::ptrdiff_t>(f * shape_count));
    }
    std::fill(step_.begin(), step_.end(), 0.0);
    for (std::size_t f = frame_count; f-- > 0;) {
      const std::size_t n = free_counts_[f];
      const std::size_t* free_shapes = free_shapes_.data() + f * shape_count;
      const double* l = factors_.data() + f * shape_count * shape_count;
      double* x = solutions_.data() + f * shape_count;
      if (f + 1 < frame_count && smoothness > 0) {
        std::fill(right_hand_side.begin(), right_hand_side.end(), 0.0);
        for (std::size_t i = 0; i < n; ++i)
          right_hand_side[i] = smoothness * step_[(f + 1) * shape_count + free_shapes[i]];
        solve_forward(l, n, shape_count, right_hand_side.data());
        for (std::size_t i = 0; i < n; ++i) x[i] += right_hand_side[i];
      }
      cholesky::solve_backward<cholesky::Roots>(cholesky::Rows{l, shape_count}, n, x);
      for (std::size_t i = 0; i < n; ++i) step_[f * shape_count + free_shapes[i]] = x[i];
    }
  }

  // Cost of a frame's weights, with those of neighbouring frames fixed.
  double frame_cost(const double* w, const double* frame_weights, std::size_t f) const {
    const double* hf = hessians.data() + f * shape_count * shape_count;
    double sum = 0;
    for (std::size_t s = 0; s < shape_count; ++s) {
      if (frame_weights[s] == 0) continue;
      double row = 0.5 * coupling_weight(f) * frame_weights[s] - linear_terms[f * shape_count + s] -
                   neighbour_sum(w, f, s);
      const double* hs = hf + s * shape_count;
      for (std::size_t k = 0; k < shape_count; ++k) row += 0.5 * hs[k] * frame_weights[k];
      sum += frame_weights[s] * row;
    }
    return sum;
  }

  // Moves a frame along its step, shortened until the cost falls.
  void apply_frame_step(double* w, std::size_t f, double* candidate) const {
    double *weights = w + f * shape_count, fraction = 1;
    const double* step = step_.data() + f * shape_count;
    const double start_cost = frame_cost(w, weights, f);
    for (int halving = 0; halving < MAX_HALVINGS; ++halving, fraction /= 2) {
      for (std::size_t s = 0; s < shape_count; ++s)
        candidate[s] = std::clamp(weights[s] + fraction * step[s], 0.0, 1.0);
      if (frame_cost(w, candidate, f) < start_cost) {
        std::copy(candidate, candidate + shape_count, weights);
        return;
      }
    }
  }

  // Minimises the cost over the weights, until a descent sweep changes them by less than
  // `tolerance`; returns the last change.
  double solve(double* w, double tolerance) {
    std::vector<double> candidate(frame_count * shape_count);
    double change = 0;
    for (int step = 0; step < MAX_NEWTON_STEPS; ++step) {
      change = 0;
      for (int i = 0; i < SWEEPS_PER_STEP; ++i) change = sweep(w, i % 2);
      if (change < tolerance) break;
      const double start_cost = total_cost(w);
      compute_newton_step(w);
      for (std::size_t i = 0; i < candidate.size(); ++i)
        candidate[i] = std::clamp(w[i] + step_[i], 0.0, 1.0);
      if (total_cost(candidate.data()) < start_cost)
        std::copy(candidate.begin(), candidate.end(), w);
      else
        for (std::size_t f = 0; f < frame_count; ++f) apply_frame_step(w, f, candidate.data());
    }
    return change;
  }

 private:
  std::vector<double> factors_, step_;
  std::vector<std::size_t> free_shapes_;
  std::vector<std::size_t> free_counts_;
  std::vector<double> solutions_, coupling_columns_;
};

// The blend shapes of a face.
struct Face {
  std::size_t landmark_count, shape_count;
  const double *neutral, *deltas;      // (N, 3), (S, N, 3)
  const double* camera;                // fx, fy, cx, cy; null for landmarks in three dimensions
  std::vector<double> rows_of_deltas;  // (N, 3, S): the three rows of each landmark
  std::vector<double> gram_matrix;     // (S, S): sum over all rows, with weights of 1

  void prepare() {
    rows_of_deltas.resize(landmark_count * 3 * shape_count);
    for (std::size_t s = 0; s < shape_count; ++s)
      for (std::size_t i = 0; i < 3 * landmark_count; ++i)
        rows_of_deltas[i * shape_count + s] = deltas[s * 3 * landmark_count + i];
    gram_matrix.assign(shape_count * shape_count, 0.0);
    for (std::size_t i = 0; i < 3 * landmark_count; ++i)
      add_outer_product(gram_matrix.data(), 1, &rows_of_deltas[i * shape_count],
                        &rows_of_deltas[i * shape_count]);
  }

  // Adds a scaled outer product to a matrix (S, S).
  void add_outer_product(double* h, double scale, const double* a, const double* b) const {
    for (std::size_t s = 0; s < shape_count; ++s) {
      const double scaled_entry = scale * a[s];
      if (scaled_entry == 0) continue;
      for (std::size_t k = 0; k < shape_count; ++k) h[s * shape_count + k] += scaled_entry * b[k];
    }
  }

  // Computes landmarks with weights, in the frame of the face (N, 3).
  void deform(const double* w, double* out) const {
    std::copy(neutral, neutral + 3 * landmark_count, out);
    for (std::size_t s = 0; s < shape_count; ++s) {
      if (w[s] == 0) continue;
      const double* d = deltas + s * 3 * landmark_count;
      for (std::size_t i = 0; i < 3 * landmark_count; ++i) out[i] += w[s] * d[i];
    }
  }
};

// Linearises one frame at its current weights and pose.
class LinearizedFrame {
 public:
  explicit LinearizedFrame(const Face& face)
      : face_(face),
        points_(3 * face.landmark_count),
        pose_shape_hessian_(face.shape_count * POSE_DOFS) {}

  // Computes the lengths of residuals (N,) and robust weights of observed landmarks; returns the
  // loss.
  double compute_residuals(const double* observed, const double* w, const double* pose,
                           double threshold, double power, double* lengths,
                           double* robust_weights) {
    face_.deform(w, points_.data());
    const Mat3 r = rotation_matrix(pose);
    const std::size_t width = face_.camera ? 2 : 3;
    double loss = 0;
    for (std::size_t n = 0; n < face_.landmark_count; ++n) {
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
    const std::size_t shape_count = face_.shape_count, landmark_count = face_.landmark_count;
    const Mat3 r = rotation_matrix(pose);
    face_.deform(w, points_.data());
    std::fill(g, g + shape_count, 0.0);
    std::fill(pose_shape_hessian_.begin(), pose_shape_hessian_.end(), 0.0);
    std::fill(pose_hessian_, pose_hessian_ + POSE_DOFS * POSE_DOFS, 0.0);
    std::fill(pose_gradient_, pose_gradient_ + POSE_DOFS, 0.0);
    if (face_.camera)
      std::fill(h, h + shape_count * shape_count, 0.0);
    else
      std::copy(face_.gram_matrix.begin(), face_.gram_matrix.end(), h);
    for (std::size_t n = 0; n < landmark_count; ++n) {
      const double* p = &points_[3 * n];
      const double* rows = &face_.rows_of_deltas[3 * n * shape_count];
      const double robust_weight = robust_weights[n];
      if (!face_.camera && robust_weight != 1)
        for (int k = 0; k < 3; ++k)
          face_.add_outer_product(h, robust_weight - 1, rows + k * shape_count,
                                  rows + k * shape_count);
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
    factor_block(factor_, POSE_DOFS, POSE_DOFS, MIN_INFORMATION_RATIO * largest, pivots);
    if (largest == 0) return;
    // H - C P^-1 C' by the rows of L^-1 C'.
    std::vector<double>& coupling = coupling_;
    coupling.resize(POSE_DOFS * shape_count);
    double right_hand_side[POSE_DOFS];
    std::copy(pose_gradient_, pose_gradient_ + POSE_DOFS, right_hand_side);
    solve_forward(factor_, POSE_DOFS, POSE_DOFS, right_hand_side);
    for (std::size_t s = 0; s < shape_count; ++s) {
      double column[POSE_DOFS];
      for (std::size_t i = 0; i < POSE_DOFS; ++i)
        column[i] = pose_shape_hessian_[i * shape_count + s];
      solve_forward(factor_, POSE_DOFS, POSE_DOFS, column);
      for (std::size_t i = 0; i < POSE_DOFS; ++i) {
        coupling[i * shape_count + s] = column[i];
        g[s] -= column[i] * right_hand_side[i];
      }
    }
    for (std::size_t i = 0; i < POSE_DOFS; ++i)
      face_.add_outer_product(h, -1, &coupling[i * shape_count], &coupling[i * shape_count]);
    std::copy(right_hand_side, right_hand_side + POSE_DOFS, right_hand_side_);
  }

  // Updates the pose for new weights. Call it after `linearize` of the same frame.
  void update_pose(const double* w, double* pose) const {
    double step[POSE_DOFS];
    for (std::size_t i = 0; i < POSE_DOFS; ++i) {
      double sum = right_hand_side_[i];
      for (std::size_t s = 0; s < face_.shape_count; ++s)
        sum -= coupling_[i * face_.shape_count + s] * w[s];
      step[i] = sum;
    }
    cholesky::solve_backward<cholesky::Roots>(cholesky::Rows{factor_, POSE_DOFS}, POSE_DOFS, step);
    apply_pose_step(step, pose);
  }

  // Stores and restores the data of a frame that `update_pose` needs.
  static std::size_t stored_size(std::size_t shape_count) {
    return POSE_DOFS * shape_count + POSE_DOFS + POSE_DOFS * POSE_DOFS;
  }
  void store(double* out) {
    coupling_.resize(POSE_DOFS * face_.shape_count);
    out = std::copy(coupling_.begin(), coupling_.end(), out);
    out = std::copy(right_hand_side_, right_hand_side_ + POSE_DOFS, out);
    std::copy(factor_, factor_ + POSE_DOFS * POSE_DOFS, out);
  }
  void restore(const double* in) {
    coupling_.resize(POSE_DOFS * face_.shape_count);
    std::copy(in, in + POSE_DOFS * face_.shape_count, coupling_.begin());
    in += POSE_DOFS * face_.shape_count;
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
    const std::size_t shape_count = face_.shape_count;
    // axis · (rotate × p) = rotate · (p × axis)
    const double pose_row[POSE_DOFS] = {p[1] * axis[2] - p[2] * axis[1],
                                        p[2] * axis[0] - p[0] * axis[2],
                                        p[0] * axis[1] - p[1] * axis[0],
                                        axis[0],
                                        axis[1],
                                        axis[2]};
    shape_row_.resize(shape_count);
    for (std::size_t s = 0; s < shape_count; ++s)
      shape_row_[s] =
          axis[0] * rows[s] + axis[1] * rows[shape_count + s] + axis[2] * rows[2 * shape_count + s];
    if (h) face_.add_outer_product(h, scale, shape_row_.data(), shape_row_.data());
    for (std::size_t s = 0; s < shape_count; ++s) g[s] += scale * z * shape_row_[s];
    for (std::size_t i = 0; i < POSE_DOFS; ++i) {
      const double scaled_entry = scale * pose_row[i];
      if (scaled_entry == 0) continue;
      for (std::size_t s = 0; s < shape_count; ++s)
        pose_shape_hessian_[i * shape_count + s] += scaled_entry * shape_row_[s];
      for (std::size_t k = 0; k < POSE_DOFS; ++k)
        pose_hessian_[i * POSE_DOFS + k] += scaled_entry * pose_row[k];
      pose_gradient_[i] += scaled_entry * z;
    }
  }

  const Face& face_;
  std::vector<double> points_, pose_shape_hessian_, shape_row_, coupling_;
  double pose_hessian_[POSE_DOFS * POSE_DOFS]{}, pose_gradient_[POSE_DOFS]{},
      factor_[POSE_DOFS * POSE_DOFS]{}, right_hand_side_[POSE_DOFS]{};
};

}  // namespace

FaceFit fit_face(In<double, 3> neutral, In<double, 3> deltas, In<double, 3> observed,
                 std::optional<In<double, 1>> camera, In<double, 2> poses, In<double, 2> weights,
                 double threshold, double smooth, double rest, double tolerance, int max_iterations,
                 bool is_warm_start) {
  const std::size_t landmark_count = neutral.shape(1), shape_count = deltas.shape(0),
                    frame_count = observed.shape(0);
  const std::size_t width = camera ? 2 : 3;
  check::at_most("observed", frame_count * landmark_count, check::MAX_ROWS);
  check::at_most("deltas", shape_count * landmark_count, check::MAX_ROWS);
  check::at_most("weights", frame_count * shape_count * std::max<std::size_t>(shape_count, 1),
                 check::MAX_ROWS);
  check::shape("neutral", neutral, {neutral.shape(0) == 1 ? 1 : frame_count, landmark_count, 3});
  check::shape("deltas", deltas, {shape_count, landmark_count, 3});
  check::shape("observed", observed, {frame_count, landmark_count, width});
  check::shape("poses", poses, {frame_count, 7});
  check::shape("weights", weights, {frame_count, shape_count});
  check::finite("neutral", neutral);
  check::finite("deltas", deltas);
  check::finite("poses", poses);
  check::finite("weights", weights);
  check::positive("threshold", threshold);
  check::non_negative("smooth", smooth);
  check::non_negative("rest", rest);
  check::positive("tolerance", tolerance);
  check::between("max_iterations", max_iterations, 1, 1000);
  if (camera) {
    check::numbers("camera", *camera, {4});
    check::positive("camera", camera->data()[0]);
    check::positive("camera", camera->data()[1]);
  }
  Out<double, 2> result(frame_count, shape_count), fitted_poses(frame_count, 7),
      lengths(frame_count, landmark_count), robust_weights(frame_count, landmark_count);
  int iteration = 0;
  double change = 0;
  Face face{landmark_count,
            shape_count,
            neutral.data(),
            deltas.data(),
            camera ? camera->data() : nullptr,
            {},
            {}};
  face.prepare();
  LinearizedFrame linear(face);
  WeightProblem problem(frame_count, shape_count, smooth);
  std::copy(weights.data(), weights.data() + frame_count * shape_count, result.get());
  std::copy(poses.data(), poses.data() + frame_count * 7, fitted_poses.get());
  std::vector<double> previous_weights(frame_count * shape_count),
      frame_data(frame_count * LinearizedFrame::stored_size(shape_count));
  double* w = result.get();
  for (std::size_t i = 0; i < frame_count * shape_count; ++i) w[i] = std::clamp(w[i], 0.0, 1.0);
  const std::size_t neutral_stride = neutral.shape(0) == 1 ? 0 : 3 * landmark_count;
  const auto update_residuals = [&](std::size_t f, double limit, double power) {
    face.neutral = neutral.data() + f * neutral_stride;
    linear.compute_residuals(observed.data() + f * landmark_count * width, w + f * shape_count,
                             fitted_poses.get() + 7 * f, limit, power,
                             lengths.get() + f * landmark_count,
                             robust_weights.get() + f * landmark_count);
  };
  for (; iteration < max_iterations; ++iteration) {
    std::copy(w, w + frame_count * shape_count, previous_weights.begin());
    // Starts with Huber's loss, which has one minimum; then uses a redescending one.
    const bool is_early = !is_warm_start && iteration < 3;
    const double power = is_early ? 1 : 2;
    const double limit = is_early && iteration == 0 ? HUGE_VAL : threshold;
    for (std::size_t f = 0; f < frame_count; ++f) {
      update_residuals(f, limit, power);
      double* h = problem.hessians.data() + f * shape_count * shape_count;
      linear.linearize(observed.data() + f * landmark_count * width, w + f * shape_count,
                       fitted_poses.get() + 7 * f, robust_weights.get() + f * landmark_count, h,
                       problem.linear_terms.data() + f * shape_count);
      linear.store(frame_data.data() + f * LinearizedFrame::stored_size(shape_count));
      for (std::size_t s = 0; s < shape_count; ++s) h[s * shape_count + s] += rest;
    }
    problem.solve(w, is_early ? std::max(tolerance, 1e-3) : tolerance);
    for (std::size_t f = 0; f < frame_count; ++f) {
      linear.restore(frame_data.data() + f * LinearizedFrame::stored_size(shape_count));
      linear.update_pose(w + f * shape_count, fitted_poses.get() + 7 * f);
    }
    change = 0;
    for (std::size_t i = 0; i < frame_count * shape_count; ++i)
      change = std::max(change, std::fabs(w[i] - previous_weights[i]));
    if (iteration >= (is_warm_start ? 1 : 4) && change < 10 * tolerance) {
      ++iteration;
      break;
    }
  }
  for (std::size_t f = 0; f < frame_count; ++f) update_residuals(f, threshold, 2);
  return {std::move(result),  std::move(fitted_poses),
          std::move(lengths), std::move(robust_weights),
          iteration,          change};
}

}  // namespace animtool
