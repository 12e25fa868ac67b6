// Triangulation of points from several cameras: a start from rays, least squares of the
// reprojection, and exclusion of cameras by their residuals.
//
// Hartley and Sturm, Triangulation, 1997; Fischler and Bolles, Random sample consensus, 1981;
// Rousseeuw, Least median of squares regression, 1984. Lens: the rational model of OpenCV.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "base/checks.h"
#include "base/cholesky.h"
#include "base/vector.h"
#include "capture/capture.h"

namespace animtool {

namespace {

constexpr double NAN_VALUE = std::numeric_limits<double>::quiet_NaN();
// Numbers of a camera: fx fy cx cy skew, k1 k2 p1 p2 k3 k4 k5 k6, rotation, translation, width and
// height of the image; 0 if unknown.
constexpr std::size_t CAMERA_NUMBER_COUNT = 27;
// Tallies of a camera in a frame, and numbers of a point.
constexpr std::size_t TALLY_COUNT = 8, POINT_NUMBER_COUNT = 5;
// Largest number of cameras of a point that are compared in pairs; 24 cameras have 276 pairs.
constexpr std::size_t MAX_PAIRED_CAMERAS = 24;
constexpr int MAX_NEWTON_STEPS = 12, MAX_INLIER_PASSES = 8, MAX_UNDISTORT_STEPS = 20;
// The search stops after a step with this squared length, relative to the variance: the next step
// would be about a thousand times shorter.
constexpr double MIN_SQUARED_STEP = 1e-6;
// Fraction of the squared gate below which residuals pass at any leverage of up to five cameras.
constexpr double SAFE_RESIDUAL_FRACTION = 0.7;
// Smallest pivot of a matrix relative to its diagonal, for rays at an angle of 1e-5.
constexpr double MIN_PIVOT = 1e-10;
// States of an observation.
enum ViewState : std::uint8_t {
  UNSEEN = 0,
  USED = 1,
  REJECTED = 2,
  INACTIVE = 3,
  NO_RAY = 4,
  UNRESOLVED = 5
};

// A symmetric matrix and its right-hand side.
struct NormalEquations {
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0, x = 0, y = 0, z = 0;

  void add(double a, double b, double c, double r, double w) {
    const double wa = w * a, wb = w * b, wc = w * c;
    xx += wa * a, xy += wa * b, xz += wa * c;
    yy += wb * b, yz += wb * c, zz += wc * c;
    x += wa * r, y += wb * r, z += wc * r;
  }
};

// The Cholesky factor of a symmetric matrix, with the reciprocals of its diagonal.
struct Factor {
  double l[9];

  // Factors a matrix; returns false if it is singular.
  bool factorize(const NormalEquations& n) {
    using namespace cholesky;
    const double min_pivots[3] = {0, MIN_PIVOT * n.yy, MIN_PIVOT * n.zz};
    double column[3];
    l[0] = n.xx, l[3] = n.xy, l[4] = n.yy, l[6] = n.xz, l[7] = n.yz, l[8] = n.zz;
    return factor<Inverses, SmallPivot::FAIL>(l, 3, 3, column,
                                              [&](std::size_t i) { return min_pivots[i]; });
  }

  // Multiplies a vector by the inverse of the factor.
  Vec solve_lower(double x, double y, double z) const {
    double solution[3] = {x, y, z};
    cholesky::solve_forward<cholesky::Inverses>(cholesky::Rows{l, 3}, 3, solution);
    return {solution[0], solution[1], solution[2]};
  }

  // Multiplies a vector by the inverse of the matrix.
  Vec solve(double x, double y, double z) const {
    const Vec h = solve_lower(x, y, z);
    const double r = h.z * l[8], q = (h.y - l[7] * r) * l[4];
    return {(h.x - l[3] * q - l[6] * r) * l[0], q, r};
  }

  // The trace of the inverse of the matrix.
  double trace() const {
    const Vec p = solve_lower(1, 0, 0), q = solve_lower(0, 1, 0), r = solve_lower(0, 0, 1);
    return p.x * p.x + p.y * p.y + p.z * p.z + q.y * q.y + q.z * q.z + r.z * r.z;
  }
};

// A distorted position (x, y), and its derivatives by the undistorted one.
struct Distortion {
  double x, y, xx, xy, yx, yy;
};

struct Camera {
  double fx, fy, cx, cy, skew;
  std::array<double, 8> k;
  std::array<double, 9> r;
  std::array<double, 3> t;
  double width, height;
  double information;   // 1 / noise^2
  bool is_undistorted;  // has no lens distortion

  // Reads the numbers of a camera.
  void read(const double* numbers, double noise) {
    fx = numbers[0], fy = numbers[1], cx = numbers[2], cy = numbers[3], skew = numbers[4];
    std::copy(numbers + 5, numbers + 13, k.begin());
    std::copy(numbers + 13, numbers + 22, r.begin());
    std::copy(numbers + 22, numbers + 25, t.begin());
    width = numbers[25], height = numbers[26];
    information = 1 / (noise * noise);
    is_undistorted = std::all_of(k.begin(), k.end(), [](double v) { return v == 0; });
  }

  // Applies the lens distortion to a normalised position.
  Distortion distort(double x, double y) const {
    const auto [k1, k2, p1, p2, k3, k4, k5, k6] = k;
    const double s = x * x + y * y;
    const double numerator = 1 + s * (k1 + s * (k2 + s * k3)),
                 denominator = 1 + s * (k4 + s * (k5 + s * k6));
    const double numerator_slope = k1 + s * (2 * k2 + 3 * s * k3),
                 denominator_slope = k4 + s * (2 * k5 + 3 * s * k6);
    const double radial = numerator / denominator,
                 radial_slope = 2 * (numerator_slope - radial * denominator_slope) / denominator;
    return {x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x),
            y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y,
            radial + x * x * radial_slope + 2 * p1 * y + 6 * p2 * x,
            x * y * radial_slope + 2 * p1 * x + 2 * p2 * y,
            x * y * radial_slope + 2 * p1 * x + 2 * p2 * y,
            radial + y * y * radial_slope + 6 * p1 * y + 2 * p2 * x};
  }

  // Whether a pixel is outside of the image. The centre of the first pixel is 0, so that half a
  // pixel around it belongs to the image.
  bool is_outside(double u, double v) const {
    return width > 0 && (u < -0.5 || v < -0.5 || u > width + 0.5 || v > height + 0.5);
  }

  // Computes the direction (x, y, 1) of a pixel; returns false if no direction near it projects to
  // the pixel.
  bool compute_ray(double u, double v, double& x, double& y) const {
    const double b = (v - cy) / fy, a = (u - cx - skew * b) / fx;
    x = a, y = b;
    if (is_undistorted) return true;
    for (int step = 0; step < MAX_UNDISTORT_STEPS; ++step) {
      const Distortion distortion = distort(x, y);
      const double residual_x = distortion.x - a, residual_y = distortion.y - b,
                   determinant = distortion.xx * distortion.yy - distortion.xy * distortion.yx;
      // The image folds where the determinant is not positive.
      if (!(determinant > 0 && distortion.xx + distortion.yy > 0)) return false;
      const double dx = (distortion.yy * residual_x - distortion.xy * residual_y) / determinant,
                   dy = (distortion.xx * residual_y - distortion.yx * residual_x) / determinant;
      x -= dx, y -= dy;
      if (dx * dx + dy * dy < 1e-24) return std::isfinite(x) && std::isfinite(y);
    }
    return false;
  }
};

// A camera's observation of a point.
struct CameraView {
  const Camera* camera;
  std::size_t camera_index;
  double u, v, x, y;  // pixel; direction
  double weight;      // information of each axis [1/px^2]
  bool is_used;
  double ru, rv;                  // residual [px]
  double au, bu, cu, av, bv, cv;  // derivatives of the residual by the point
  double depth;

  // Squared residual over its variance.
  double squared_residual() const { return weight * (ru * ru + rv * rv); }

  // Computes the residual of a point, and its derivatives; returns whether the point is in front of
  // the camera.
  bool project(const Vec& p) {
    const auto& r = camera->r;
    const auto& t = camera->t;
    const double z = r[6] * p.x + r[7] * p.y + r[8] * p.z + t[2];
    const double inverse_depth = 1 / z;
    const double a = (r[0] * p.x + r[1] * p.y + r[2] * p.z + t[0]) * inverse_depth;
    const double b = (r[3] * p.x + r[4] * p.y + r[5] * p.z + t[1]) * inverse_depth;
    const double ax = (r[0] - a * r[6]) * inverse_depth, ay = (r[1] - a * r[7]) * inverse_depth,
                 az = (r[2] - a * r[8]) * inverse_depth;
    const double bx = (r[3] - b * r[6]) * inverse_depth, by = (r[4] - b * r[7]) * inverse_depth,
                 bz = (r[5] - b * r[8]) * inverse_depth;
    const double fx = camera->fx, fy = camera->fy, skew = camera->skew;
    depth = z;
    if (camera->is_undistorted) {
      ru = fx * a + skew * b + camera->cx - u, rv = fy * b + camera->cy - v;
      au = fx * ax + skew * bx, bu = fx * ay + skew * by, cu = fx * az + skew * bz;
      av = fy * bx, bv = fy * by, cv = fy * bz;
    } else {
      const Distortion distortion = camera->distort(a, b);
      const double p0 = fx * distortion.xx + skew * distortion.yx,
                   p1 = fx * distortion.xy + skew * distortion.yy, q0 = fy * distortion.yx,
                   q1 = fy * distortion.yy;
      ru = fx * distortion.x + skew * distortion.y + camera->cx - u,
      rv = fy * distortion.y + camera->cy - v;
      au = p0 * ax + p1 * bx, bu = p0 * ay + p1 * by, cu = p0 * az + p1 * bz;
      av = q0 * ax + q1 * bx, bv = q0 * ay + q1 * by, cv = q0 * az + q1 * bz;
    }
    return z > 0;
  }

  // Adds the equations of the ray to a linear system.
  void add_ray(NormalEquations& equations, double weight) const {
    const auto& r = camera->r;
    const auto& t = camera->t;
    equations.add(r[0] - x * r[6], r[1] - x * r[7], r[2] - x * r[8], x * t[2] - t[0], weight);
    equations.add(r[3] - y * r[6], r[4] - y * r[7], r[5] - y * r[8], y * t[2] - t[1], weight);
  }
};

// A solved point, with the factor of its normal equations.
struct Solution {
  Vec point{NAN_VALUE, NAN_VALUE, NAN_VALUE};
  Factor factor{};
  double trace = 0;  // trace of the matrix
  bool has_converged = false;
};

bool is_finite(const Vec& p) {
  return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z);
}

// Solves a point from the cameras that observe it.
class PointSolver {
 public:
  std::array<CameraView, 256> views;
  std::size_t count = 0;
  double squared_gate = 0;  // of weighted residuals

  std::size_t count_used() const {
    std::size_t n = 0;
    for (std::size_t i = 0; i < count; ++i) n += views[i].is_used;
    return n;
  }

  // Solves the linear equations of the rays that are used.
  bool solve_linear(Vec& p) const {
    NormalEquations equations;
    for (std::size_t i = 0; i < count; ++i)
      if (views[i].is_used) views[i].add_ray(equations, 1);
    Factor factor;
    if (!factor.factorize(equations)) return false;
    p = factor.solve(equations.x, equations.y, equations.z);
    return is_finite(p);
  }

  // Weighted least squares of the reprojection, from a start.
  Solution refine(Vec p) {
    Solution solution;
    for (int step = 0; step < MAX_NEWTON_STEPS; ++step) {
      NormalEquations equations;
      for (std::size_t i = 0; i < count; ++i) {
        CameraView& view = views[i];
        if (!view.is_used) continue;
        if (!view.project(p)) return solution;
        equations.add(view.au, view.bu, view.cu, view.ru, view.weight);
        equations.add(view.av, view.bv, view.cv, view.rv, view.weight);
      }
      if (!solution.factor.factorize(equations)) return solution;
      const Vec correction = solution.factor.solve(equations.x, equations.y, equations.z);
      p.x -= correction.x, p.y -= correction.y, p.z -= correction.z;
      if (!(equations.x * correction.x + equations.y * correction.y + equations.z * correction.z >
            MIN_SQUARED_STEP)) {
        for (std::size_t i = 0; i < count; ++i) {
          CameraView& view = views[i];
          view.ru -= view.au * correction.x + view.bu * correction.y + view.cu * correction.z;
          view.rv -= view.av * correction.x + view.bv * correction.y + view.cv * correction.z;
        }
        solution.trace = equations.xx + equations.yy + equations.zz;
        solution.point = p, solution.has_converged = is_finite(p);
        return solution;
      }
    }
    return solution;
  }

  // Solves with the cameras that are used.
  Solution solve() {
    Vec p{};
    return solve_linear(p) ? refine(p) : Solution{};
  }

  // A squared residual over its variance, corrected for its leverage on the point.
  double studentised_residual(const CameraView& view, const Solution& solution) const {
    if (!view.is_used) return view.squared_residual();
    const double weight = view.weight;
    const Vec u = solution.factor.solve_lower(view.au, view.bu, view.cu),
              v = solution.factor.solve_lower(view.av, view.bv, view.cv);
    const double a = 1 - weight * (u.x * u.x + u.y * u.y + u.z * u.z),
                 b = -weight * (u.x * v.x + u.y * v.y + u.z * v.z),
                 c = 1 - weight * (v.x * v.x + v.y * v.y + v.z * v.z);
    const double determinant = a * c - b * b;
    // Full leverage leaves no residual.
    if (!(determinant > 1e-9)) return view.squared_residual();
    return weight * (c * view.ru * view.ru - 2 * b * view.ru * view.rv + a * view.rv * view.rv) /
           determinant;
  }

  void project_all(const Vec& p) {
    for (std::size_t i = 0; i < count; ++i)
      if (!views[i].project(p)) views[i].ru = views[i].rv = std::numeric_limits<double>::max();
  }

  // Whether all residuals are well below the gate.
  bool is_consistent() const {
    for (std::size_t i = 0; i < count; ++i)
      if (!(views[i].squared_residual() <= SAFE_RESIDUAL_FRACTION * squared_gate)) return false;
    return true;
  }

  double max_residual(const Solution& solution, std::size_t& index) const {
    double largest = -1;
    for (std::size_t i = 0; i < count; ++i) {
      if (!views[i].is_used) continue;
      const double residual = studentised_residual(views[i], solution);
      if (!(residual <= largest)) largest = residual, index = i;
    }
    return largest;
  }

  // Excludes the camera with the largest residual until the others agree; then includes those that
  // agree again.
  Solution exclude_outliers(Solution solution) {
    std::size_t used_count = count, worst_index = 0;
    while (solution.has_converged && max_residual(solution, worst_index) > squared_gate &&
           used_count > 2) {
      views[worst_index].is_used = false, --used_count;
      solution = solve();
    }
    return solution.has_converged ? refine_inliers(solution) : solution;
  }

  // Repeats the solution with the cameras that pass the gate, until they do not change.
  Solution refine_inliers(Solution solution) {
    for (int pass = 0; pass < MAX_INLIER_PASSES && solution.has_converged; ++pass) {
      for (std::size_t i = 0; i < count; ++i)
        if (!views[i].is_used && !views[i].project(solution.point))
          views[i].ru = views[i].rv = std::numeric_limits<double>::max();
      bool has_changed = false;
      std::size_t used_count = 0;
      std::array<bool, 256> is_passing{};
      for (std::size_t i = 0; i < count; ++i) {
        is_passing[i] = studentised_residual(views[i], solution) <= squared_gate;
        has_changed = has_changed || is_passing[i] != views[i].is_used;
        used_count += is_passing[i];
      }
      if (!has_changed || used_count < 2) return used_count < 2 ? Solution{} : solution;
      for (std::size_t i = 0; i < count; ++i) views[i].is_used = is_passing[i];
      solution = refine(solution.point);
    }
    return solution;
  }

  // Cost of a point: residuals truncated at the gate; counts the cameras that agree.
  double cost(const Vec& p, std::size_t& agreeing_count) {
    double sum = 0;
    agreeing_count = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const double residual = views[i].project(p) ? views[i].squared_residual() : squared_gate;
      if (residual < squared_gate)
        sum += residual, ++agreeing_count;
      else
        sum += squared_gate;
    }
    return sum;
  }

  // Computes the point from the rays of two cameras.
  bool intersect_pair(std::size_t i, std::size_t j, Vec& p) const {
    NormalEquations equations;
    views[i].add_ray(equations, 1), views[j].add_ray(equations, 1);
    Factor factor;
    if (!factor.factorize(equations)) return false;
    p = factor.solve(equations.x, equations.y, equations.z);
    return is_finite(p);
  }

  // The point on which most cameras agree, of those from all pairs. Fails if several points have
  // two cameras, and none has more.
  Solution find_consensus() {
    const std::size_t compared_count = std::min(count, MAX_PAIRED_CAMERAS);
    double min_cost = std::numeric_limits<double>::max();
    std::size_t best_count = 0, tie_count = 0;
    Vec best_point{};
    for (std::size_t i = 0; i + 1 < compared_count; ++i)
      for (std::size_t j = i + 1; j < compared_count; ++j) {
        Vec p{};
        std::size_t agreeing_count = 0;
        if (!intersect_pair(i, j, p)) continue;
        const double point_cost = cost(p, agreeing_count);
        if (agreeing_count == 2 && count > 2) ++tie_count;
        if (point_cost < min_cost)
          min_cost = point_cost, best_count = agreeing_count, best_point = p;
      }
    if (best_count < 2 || (best_count == 2 && tie_count > 1)) return Solution{};
    project_all(best_point);
    for (std::size_t i = 0; i < count; ++i)
      views[i].is_used = views[i].squared_residual() <= squared_gate;
    const Solution solution = refine(best_point);
    return solution.has_converged ? refine_inliers(solution) : solution;
  }

  Solution solve_robust() {
    Solution solution_of_all = solve();
    if (solution_of_all.has_converged && is_consistent()) return solution_of_all;
    std::size_t worst_index = 0;
    if (solution_of_all.has_converged && max_residual(solution_of_all, worst_index) <= squared_gate)
      return solution_of_all;
    if (count < 3) return Solution{};
    if (count > 4) {
      const Solution solution = exclude_outliers(solution_of_all);
      // One camera against four or more that agree: a search over pairs would give the same.
      if (solution.has_converged && count_used() + 1 >= count && count_used() >= 4) return solution;
    }
    for (std::size_t i = 0; i < count; ++i) views[i].is_used = true;
    return find_consensus();
  }

  // The smallest median of squared residuals [px^2], over the points of all pairs.
  double find_least_median() {
    const std::size_t compared_count = std::min(count, MAX_PAIRED_CAMERAS);
    double min_median = NAN_VALUE;
    std::vector<double> residuals(count);
    for (std::size_t i = 0; i + 1 < compared_count; ++i)
      for (std::size_t j = i + 1; j < compared_count; ++j) {
        Vec p{};
        if (!intersect_pair(i, j, p)) continue;
        for (std::size_t k = 0; k < count; ++k)
          residuals[k] = views[k].project(p) ? views[k].ru * views[k].ru + views[k].rv * views[k].rv
                                             : std::numeric_limits<double>::max();
        const auto median = residuals.begin() + static_cast<std::ptrdiff_t>(count / 2);
        std::nth_element(residuals.begin(), median, residuals.end());
        if (!(*median >= min_median)) min_median = *median;
      }
    return min_median;
  }
};

std::vector<Camera> read_cameras(In<double, 2> numbers, const double* noise) {
  std::vector<Camera> cameras(numbers.shape(0));
  for (std::size_t c = 0; c < cameras.size(); ++c)
    cameras[c].read(numbers.data() + c * CAMERA_NUMBER_COUNT, noise ? noise[c] : 1);
  return cameras;
}

void check_views(const In<double, 4>& pixels, const In<double, 2>& cameras) {
  check::shape("pixels", pixels, {check::ANY, check::ANY, check::ANY, 2});
  check::between("cameras", pixels.shape(1), std::size_t{0}, std::size_t{256});
  check::numbers("cameras", cameras, {pixels.shape(1), CAMERA_NUMBER_COUNT});
  for (std::size_t c = 0; c < cameras.shape(0); ++c) {
    check::positive("cameras", cameras.data()[c * CAMERA_NUMBER_COUNT]);
    check::positive("cameras", cameras.data()[c * CAMERA_NUMBER_COUNT + 1]);
  }
}

}  // namespace

Triangulation triangulate_points(In<double, 4> pixels, std::optional<In<double, 3>> confidences,
                                 In<double, 2> cameras, In<bool, 2> is_active, In<double, 1> noise,
                                 double outlier_gate, double max_condition, bool has_details) {
  check_views(pixels, cameras);
  const std::size_t F = pixels.shape(0), C = pixels.shape(1), M = pixels.shape(2);
  if (confidences) check::shape("confidences", *confidences, {F, C, M});
  check::shape("is_active", is_active, {F, C});
  check::shape("noise", noise, {C});
  for (std::size_t c = 0; c < C; ++c) check::positive("noise", noise.data()[c]);
  check::positive("outlier_gate", outlier_gate);
  check::positive("max_condition", max_condition);
  const double* confidence_data = confidences ? confidences->data() : nullptr;

  const std::size_t detail_frames = has_details ? F : 0;
  Out<double, 3> points(F, M, 3), numbers(F, M, POINT_NUMBER_COUNT), tallies(F, C, TALLY_COUNT);
  Out<float, 4> residuals(detail_frames, C, M, 2);
  Out<std::uint8_t, 3> states(detail_frames, C, M);
  const std::vector<Camera> camera_models = read_cameras(cameras, noise.data());
  std::fill_n(residuals.get(), detail_frames * C * M * 2, std::numeric_limits<float>::quiet_NaN());
  std::fill_n(tallies.get(), F * C * TALLY_COUNT, 0.0);
  PointSolver point_solver;
  point_solver.squared_gate = outlier_gate * outlier_gate;
  std::array<std::uint8_t, 256> view_states;
  for (std::size_t f = 0; f < F; ++f)
    for (std::size_t m = 0; m < M; ++m) {
      double* const frame_tallies = tallies.get() + f * C * TALLY_COUNT;
      const auto pixel = [&](std::size_t c) { return pixels.data() + 2 * ((f * C + c) * M + m); };
      point_solver.count = 0;
      std::size_t visible_count = 0;
      for (std::size_t c = 0; c < C; ++c) {
        const double u = pixel(c)[0], v = pixel(c)[1];
        const double confidence = confidence_data ? confidence_data[(f * C + c) * M + m] : 1;
        view_states[c] = UNSEEN;
        if (!(std::isfinite(u) && std::isfinite(v) && confidence > 0 && std::isfinite(confidence)))
          continue;
        CameraView& view = point_solver.views[point_solver.count];
        frame_tallies[c * TALLY_COUNT] += 1,
            frame_tallies[c * TALLY_COUNT + 7] += camera_models[c].is_outside(u, v);
        if (!camera_models[c].compute_ray(u, v, view.x, view.y)) {
          view_states[c] = NO_RAY, frame_tallies[c * TALLY_COUNT + 4] += 1;
          continue;
        }
        ++visible_count;
        if (!is_active.data()[f * C + c]) {
          view_states[c] = INACTIVE;
          continue;
        }
        view_states[c] = UNRESOLVED;
        view.camera = &camera_models[c], view.camera_index = c, view.u = u, view.v = v,
        view.is_used = true;
        view.weight = camera_models[c].information * confidence;
        ++point_solver.count;
      }
      Solution solution = point_solver.count < 2 ? Solution{} : point_solver.solve_robust();
      const std::size_t used_count = solution.has_converged ? point_solver.count_used() : 0;
      const double trace = solution.has_converged ? solution.factor.trace() : 0;
      // Nearly parallel rays do not determine the depth.
      if (used_count < 2 || !(trace * solution.trace <= max_condition)) solution = Solution{};

      double* position = points.get() + (f * M + m) * 3;
      double* point_numbers = numbers.get() + (f * M + m) * POINT_NUMBER_COUNT;
      position[0] = solution.point.x, position[1] = solution.point.y,
      position[2] = solution.point.z;
      point_numbers[0] = point_numbers[1] = point_numbers[2] = NAN_VALUE;
      point_numbers[3] = solution.has_converged ? static_cast<double>(used_count) : 0,
      point_numbers[4] = static_cast<double>(visible_count);
      if (solution.has_converged) {
        double pixel_squares = 0, metric_squares = 0;
        const auto tally_view = [&](CameraView& view, bool has_residual, std::uint8_t view_state) {
          double* const tally = frame_tallies + view.camera_index * TALLY_COUNT;
          view_states[view.camera_index] = view_state, tally[2] += 1;
          if (has_details && has_residual) {
            float* residual_row = residuals.get() + 2 * ((f * C + view.camera_index) * M + m);
            residual_row[0] = static_cast<float>(view.ru),
            residual_row[1] = static_cast<float>(view.rv);
          }
          if (view_state != USED) {
            tally[3] += view_state == REJECTED || !has_residual ||
                        view.squared_residual() > point_solver.squared_gate;
            return;
          }
          const double scale = 2 * view.depth / (view.camera->fx + view.camera->fy);
          const double square = view.ru * view.ru + view.rv * view.rv,
                       metric_square = square * scale * scale;
          tally[1] += 1, tally[5] += square, tally[6] += metric_square;
          pixel_squares += square, metric_squares += metric_square;
        };
        for (std::size_t i = 0; i < point_solver.count; ++i) {
          CameraView& view = point_solver.views[i];
          const bool has_residual = view.is_used || view.project(solution.point);
          tally_view(view, has_residual, view.is_used ? USED : REJECTED);
        }
        for (std::size_t c = 0; visible_count > point_solver.count && c < C; ++c) {
          if (view_states[c] != INACTIVE) continue;
          CameraView view{};
          view.camera = &camera_models[c], view.camera_index = c, view.u = pixel(c)[0],
          view.v = pixel(c)[1];
          view.weight = camera_models[c].information;
          tally_view(view, view.project(solution.point), INACTIVE);
        }
        point_numbers[0] = std::sqrt(pixel_squares / point_numbers[3]),
        point_numbers[1] = std::sqrt(metric_squares / point_numbers[3]);
        point_numbers[2] = std::sqrt(trace);
      }
      for (std::size_t c = 0; has_details && c < C; ++c)
        states.get()[(f * C + c) * M + m] = view_states[c];
    }
  return {std::move(points), std::move(numbers), std::move(tallies), std::move(residuals),
          std::move(states)};
}

Out<double, 2> least_median_residuals(In<double, 4> pixels, In<double, 2> cameras) {
  check_views(pixels, cameras);
  const std::size_t F = pixels.shape(0), C = pixels.shape(1), M = pixels.shape(2);
  Out<double, 2> medians(F, M);
  const std::vector<Camera> camera_models = read_cameras(cameras, nullptr);
  PointSolver point_solver;
  for (std::size_t f = 0; f < F; ++f)
    for (std::size_t m = 0; m < M; ++m) {
      point_solver.count = 0;
      for (std::size_t c = 0; c < C; ++c) {
        const double* pixel = pixels.data() + 2 * ((f * C + c) * M + m);
        CameraView& view = point_solver.views[point_solver.count];
        if (!(std::isfinite(pixel[0]) && std::isfinite(pixel[1]))) continue;
        if (!camera_models[c].compute_ray(pixel[0], pixel[1], view.x, view.y)) continue;
        view.camera = &camera_models[c], view.u = pixel[0], view.v = pixel[1], view.weight = 1,
        view.is_used = true;
        ++point_solver.count;
      }
      medians.get()[f * M + m] =
          point_solver.count < 2 ? NAN_VALUE : std::sqrt(point_solver.find_least_median());
    }
  return medians;
}

}  // namespace animtool
