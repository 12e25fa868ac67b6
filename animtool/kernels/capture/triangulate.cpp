// Triangulation of points from several cameras: start from rays, least squares of the
// reprojection, and cameras excluded by their residuals.
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
// Numbers of a camera: fx fy cx cy skew, k1 k2 p1 p2 k3 k4 k5 k6, rotation, translation, width
// and height of the image, 0 if unknown.
constexpr std::size_t CAMERA_NUMBERS = 27;
// Tallies of a camera in a frame, and values of a point.
constexpr std::size_t TALLIES = 8, POINT_NUMBERS = 5;
// Most cameras of a point compared in pairs; 24 are 276 pairs.
constexpr std::size_t MAX_PAIRED = 24;
constexpr int MAX_STEPS = 12, MAX_INLIER_PASSES = 8, UNDISTORT_STEPS = 20;
// A step whose squared length is this much of the variance ends the search: the next one
// would be about a thousand times as short.
constexpr double SMALL_STEP = 1e-6;
// Fraction of the squared gate below which residuals pass at any leverage of five cameras.
constexpr double SAFE_RESIDUAL = 0.7;
// Smallest pivot of a matrix against its own diagonal: rays of an angle of 1e-5.
constexpr double SINGULAR = 1e-10;
enum State : std::uint8_t {
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

// The factor of a symmetric matrix, with the inverses of its diagonal.
struct Factor {
  double l[9];

  bool of(const NormalEquations& n) {
    using namespace cholesky;
    const double least[3] = {0, SINGULAR * n.yy, SINGULAR * n.zz};
    double column[3];
    l[0] = n.xx, l[3] = n.xy, l[4] = n.yy, l[6] = n.xz, l[7] = n.yz, l[8] = n.zz;
    return factor<Inverses, Small::FAIL>(l, 3, 3, column, [&](std::size_t i) { return least[i]; });
  }

  // The rows of the inverse of the factor, times a vector.
  Vec half(double x, double y, double z) const {
    double to[3] = {x, y, z};
    cholesky::solve_forward<cholesky::Inverses>(cholesky::Rows{l, 3}, 3, to);
    return {to[0], to[1], to[2]};
  }

  Vec solve(double x, double y, double z) const {
    const Vec h = half(x, y, z);
    const double r = h.z * l[8], q = (h.y - l[7] * r) * l[4];
    return {(h.x - l[3] * q - l[6] * r) * l[0], q, r};
  }

  // The trace of the inverse of the matrix.
  double trace() const {
    const Vec p = half(1, 0, 0), q = half(0, 1, 0), r = half(0, 0, 1);
    return p.x * p.x + p.y * p.y + p.z * p.z + q.y * q.y + q.z * q.z + r.z * r.z;
  }
};

struct Distorted {
  double x, y, xx, xy, yx, yy;  // a distorted place, and its slopes by the place
};

struct Camera {
  double fx, fy, cx, cy, skew;
  std::array<double, 8> k;
  std::array<double, 9> r;
  std::array<double, 3> t;
  double width, height;
  double information;  // 1 / noise^2
  bool plain;          // without distortion

  void read(const double* n, double noise) {
    fx = n[0], fy = n[1], cx = n[2], cy = n[3], skew = n[4];
    std::copy(n + 5, n + 13, k.begin());
    std::copy(n + 13, n + 22, r.begin());
    std::copy(n + 22, n + 25, t.begin());
    width = n[25], height = n[26];
    information = 1 / (noise * noise);
    plain = std::all_of(k.begin(), k.end(), [](double v) { return v == 0; });
  }

  Distorted distort(double x, double y) const {
    const auto [k1, k2, p1, p2, k3, k4, k5, k6] = k;
    const double s = x * x + y * y;
    const double numerator = 1 + s * (k1 + s * (k2 + s * k3)),
                 denominator = 1 + s * (k4 + s * (k5 + s * k6));
    const double numerator_s = k1 + s * (2 * k2 + 3 * s * k3),
                 denominator_s = k4 + s * (2 * k5 + 3 * s * k6);
    const double g = numerator / denominator,
                 g_s = 2 * (numerator_s - g * denominator_s) / denominator;
    return {x * g + 2 * p1 * x * y + p2 * (s + 2 * x * x),
            y * g + p1 * (s + 2 * y * y) + 2 * p2 * x * y,
            g + x * x * g_s + 2 * p1 * y + 6 * p2 * x,
            x * y * g_s + 2 * p1 * x + 2 * p2 * y,
            x * y * g_s + 2 * p1 * x + 2 * p2 * y,
            g + y * y * g_s + 6 * p1 * y + 2 * p2 * x};
  }

  // The centre of the first pixel is 0, so that half a pixel around belongs to the image.
  bool outside(double u, double v) const {
    return width > 0 && (u < -0.5 || v < -0.5 || u > width + 0.5 || v > height + 0.5);
  }

  // The direction (x, y, 1) of a pixel; false if no direction near it projects there.
  bool ray(double u, double v, double& x, double& y) const {
    const double b = (v - cy) / fy, a = (u - cx - skew * b) / fx;
    x = a, y = b;
    if (plain) return true;
    for (int step = 0; step < UNDISTORT_STEPS; ++step) {
      const Distorted l = distort(x, y);
      const double ra = l.x - a, rb = l.y - b, det = l.xx * l.yy - l.xy * l.yx;
      // The image folds where the determinant is not positive.
      if (!(det > 0 && l.xx + l.yy > 0)) return false;
      const double dx = (l.yy * ra - l.xy * rb) / det, dy = (l.xx * rb - l.yx * ra) / det;
      x -= dx, y -= dy;
      if (dx * dx + dy * dy < 1e-24) return std::isfinite(x) && std::isfinite(y);
    }
    return false;
  }
};

// A camera's observation of a point.
struct CameraView {
  const Camera* camera;
  std::size_t number;
  double u, v, x, y;  // pixel; direction
  double weight;      // information of each axis [1/px^2]
  bool used;
  double ru, rv;                  // residual [px]
  double au, bu, cu, av, bv, cv;  // its slopes by the point
  double depth;

  double squared() const { return weight * (ru * ru + rv * rv); }

  bool project(const Vec& p) {
    const auto& r = camera->r;
    const auto& t = camera->t;
    const double z = r[6] * p.x + r[7] * p.y + r[8] * p.z + t[2];
    const double i = 1 / z;
    const double a = (r[0] * p.x + r[1] * p.y + r[2] * p.z + t[0]) * i;
    const double b = (r[3] * p.x + r[4] * p.y + r[5] * p.z + t[1]) * i;
    const double ax = (r[0] - a * r[6]) * i, ay = (r[1] - a * r[7]) * i, az = (r[2] - a * r[8]) * i;
    const double bx = (r[3] - b * r[6]) * i, by = (r[4] - b * r[7]) * i, bz = (r[5] - b * r[8]) * i;
    const double fx = camera->fx, fy = camera->fy, skew = camera->skew;
    depth = z;
    if (camera->plain) {
      ru = fx * a + skew * b + camera->cx - u, rv = fy * b + camera->cy - v;
      au = fx * ax + skew * bx, bu = fx * ay + skew * by, cu = fx * az + skew * bz;
      av = fy * bx, bv = fy * by, cv = fy * bz;
    } else {
      const Distorted l = camera->distort(a, b);
      const double p0 = fx * l.xx + skew * l.yx, p1 = fx * l.xy + skew * l.yy, q0 = fy * l.yx,
                   q1 = fy * l.yy;
      ru = fx * l.x + skew * l.y + camera->cx - u, rv = fy * l.y + camera->cy - v;
      au = p0 * ax + p1 * bx, bu = p0 * ay + p1 * by, cu = p0 * az + p1 * bz;
      av = q0 * ax + q1 * bx, bv = q0 * ay + q1 * by, cv = q0 * az + q1 * bz;
    }
    return z > 0;
  }

  void add_ray(NormalEquations& n, double w) const {
    const auto& r = camera->r;
    const auto& t = camera->t;
    n.add(r[0] - x * r[6], r[1] - x * r[7], r[2] - x * r[8], x * t[2] - t[0], w);
    n.add(r[3] - y * r[6], r[4] - y * r[7], r[5] - y * r[8], y * t[2] - t[1], w);
  }
};

struct Solution {
  Vec point{NAN_VALUE, NAN_VALUE, NAN_VALUE};
  Factor factor{};
  double trace = 0;  // of the matrix
  bool converged = false;
};

bool finite(const Vec& p) { return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z); }

// A point and the cameras that observe it.
class Point {
 public:
  std::array<CameraView, 256> views;
  std::size_t count = 0;
  double gate = 0;  // squared, of weighted residuals

  std::size_t used() const {
    std::size_t n = 0;
    for (std::size_t i = 0; i < count; ++i) n += views[i].used;
    return n;
  }

  bool solve_linear(Vec& p) const {
    NormalEquations n;
    for (std::size_t i = 0; i < count; ++i)
      if (views[i].used) views[i].add_ray(n, 1);
    Factor f;
    if (!f.of(n)) return false;
    p = f.solve(n.x, n.y, n.z);
    return finite(p);
  }

  // Weighted least squares of the reprojection, from a start.
  Solution refine(Vec p) {
    Solution solution;
    for (int step = 0; step < MAX_STEPS; ++step) {
      NormalEquations n;
      for (std::size_t i = 0; i < count; ++i) {
        CameraView& s = views[i];
        if (!s.used) continue;
        if (!s.project(p)) return solution;
        n.add(s.au, s.bu, s.cu, s.ru, s.weight);
        n.add(s.av, s.bv, s.cv, s.rv, s.weight);
      }
      if (!solution.factor.of(n)) return solution;
      const Vec d = solution.factor.solve(n.x, n.y, n.z);
      p.x -= d.x, p.y -= d.y, p.z -= d.z;
      if (!(n.x * d.x + n.y * d.y + n.z * d.z > SMALL_STEP)) {
        for (std::size_t i = 0; i < count; ++i) {
          CameraView& s = views[i];
          s.ru -= s.au * d.x + s.bu * d.y + s.cu * d.z;
          s.rv -= s.av * d.x + s.bv * d.y + s.cv * d.z;
        }
        solution.trace = n.xx + n.yy + n.zz;
        solution.point = p, solution.converged = finite(p);
        return solution;
      }
    }
    return solution;
  }

  Solution solve() {
    Vec p{};
    return solve_linear(p) ? refine(p) : Solution{};
  }

  // A residual over its tolerance, without its own leverage on the point.
  double studentised(const CameraView& s, const Solution& solution) const {
    if (!s.used) return s.squared();
    const double w = s.weight;
    const Vec u = solution.factor.half(s.au, s.bu, s.cu),
              v = solution.factor.half(s.av, s.bv, s.cv);
    const double a = 1 - w * (u.x * u.x + u.y * u.y + u.z * u.z),
                 b = -w * (u.x * v.x + u.y * v.y + u.z * v.z),
                 c = 1 - w * (v.x * v.x + v.y * v.y + v.z * v.z);
    const double det = a * c - b * b;
    // Full leverage leaves no residual.
    if (!(det > 1e-9)) return s.squared();
    return w * (c * s.ru * s.ru - 2 * b * s.ru * s.rv + a * s.rv * s.rv) / det;
  }

  void project_all(const Vec& p) {
    for (std::size_t i = 0; i < count; ++i)
      if (!views[i].project(p)) views[i].ru = views[i].rv = std::numeric_limits<double>::max();
  }

  bool is_consistent() const {
    for (std::size_t i = 0; i < count; ++i)
      if (!(views[i].squared() <= SAFE_RESIDUAL * gate)) return false;
    return true;
  }

  double worst(const Solution& solution, std::size_t& which) const {
    double largest = -1;
    for (std::size_t i = 0; i < count; ++i) {
      if (!views[i].used) continue;
      const double at = studentised(views[i], solution);
      if (!(at <= largest)) largest = at, which = i;
    }
    return largest;
  }

  // Exclude the worst camera until the rest agree; then include those that agree again.
  Solution exclude_outliers(Solution solution) {
    std::size_t used_count = count, which = 0;
    while (solution.converged && worst(solution, which) > gate && used_count > 2) {
      views[which].used = false, --used_count;
      solution = solve();
    }
    return solution.converged ? refine_inliers(solution) : solution;
  }

  // Cameras with a passing residual, iterated to a fixed set.
  Solution refine_inliers(Solution solution) {
    for (int round = 0; round < MAX_INLIER_PASSES && solution.converged; ++round) {
      for (std::size_t i = 0; i < count; ++i)
        if (!views[i].used && !views[i].project(solution.point))
          views[i].ru = views[i].rv = std::numeric_limits<double>::max();
      bool changed = false;
      std::size_t used_count = 0;
      std::array<bool, 256> next{};
      for (std::size_t i = 0; i < count; ++i) {
        next[i] = studentised(views[i], solution) <= gate;
        changed = changed || next[i] != views[i].used;
        used_count += next[i];
      }
      if (!changed || used_count < 2) return used_count < 2 ? Solution{} : solution;
      for (std::size_t i = 0; i < count; ++i) views[i].used = next[i];
      solution = refine(solution.point);
    }
    return solution;
  }

  // The cost of a point: residuals truncated at the gate.
  double cost(const Vec& p, std::size_t& agree) {
    double sum = 0;
    agree = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const double at = views[i].project(p) ? views[i].squared() : gate;
      if (at < gate)
        sum += at, ++agree;
      else
        sum += gate;
    }
    return sum;
  }

  bool pair(std::size_t i, std::size_t j, Vec& p) const {
    NormalEquations n;
    views[i].add_ray(n, 1), views[j].add_ray(n, 1);
    Factor f;
    if (!f.of(n)) return false;
    p = f.solve(n.x, n.y, n.z);
    return finite(p);
  }

  // The point that most cameras agree on, among those of all pairs. None if two distinct
  // ones have as many, and no more than two.
  Solution consensus() {
    const std::size_t compared = std::min(count, MAX_PAIRED);
    double best = std::numeric_limits<double>::max();
    std::size_t agreed = 0, ties = 0;
    Vec at{};
    for (std::size_t i = 0; i + 1 < compared; ++i)
      for (std::size_t j = i + 1; j < compared; ++j) {
        Vec p{};
        std::size_t agree = 0;
        if (!pair(i, j, p)) continue;
        const double sum = cost(p, agree);
        if (agree == 2 && count > 2) ++ties;
        if (sum < best) best = sum, agreed = agree, at = p;
      }
    if (agreed < 2 || (agreed == 2 && ties > 1)) return Solution{};
    project_all(at);
    for (std::size_t i = 0; i < count; ++i) views[i].used = views[i].squared() <= gate;
    const Solution solution = refine(at);
    return solution.converged ? refine_inliers(solution) : solution;
  }

  Solution solve_robust() {
    Solution all = solve();
    if (all.converged && is_consistent()) return all;
    std::size_t which = 0;
    if (all.converged && worst(all, which) <= gate) return all;
    if (count < 3) return Solution{};
    if (count > 4) {
      const Solution solution = exclude_outliers(all);
      // One camera against four or more that agree: no pair would differ.
      if (solution.converged && used() + 1 >= count && used() >= 4) return solution;
    }
    for (std::size_t i = 0; i < count; ++i) views[i].used = true;
    return consensus();
  }

  // The least median of squared residuals [px^2] over the points of every pair.
  double least_median() {
    const std::size_t compared = std::min(count, MAX_PAIRED);
    double best = NAN_VALUE;
    std::vector<double> at(count);
    for (std::size_t i = 0; i + 1 < compared; ++i)
      for (std::size_t j = i + 1; j < compared; ++j) {
        Vec p{};
        if (!pair(i, j, p)) continue;
        for (std::size_t k = 0; k < count; ++k)
          at[k] = views[k].project(p) ? views[k].ru * views[k].ru + views[k].rv * views[k].rv
                                      : std::numeric_limits<double>::max();
        const auto middle = at.begin() + static_cast<std::ptrdiff_t>(count / 2);
        std::nth_element(at.begin(), middle, at.end());
        if (!(*middle >= best)) best = *middle;
      }
    return best;
  }
};

std::vector<Camera> read_cameras(In<double, 2> numbers, const double* noise) {
  std::vector<Camera> cameras(numbers.shape(0));
  for (std::size_t c = 0; c < cameras.size(); ++c)
    cameras[c].read(numbers.data() + c * CAMERA_NUMBERS, noise ? noise[c] : 1);
  return cameras;
}

void check_views(const In<double, 4>& pixels, const In<double, 2>& cameras) {
  check::shape("pixels", pixels, {check::ANY, check::ANY, check::ANY, 2});
  check::between("cameras", pixels.shape(1), std::size_t{0}, std::size_t{256});
  check::numbers("cameras", cameras, {pixels.shape(1), CAMERA_NUMBERS});
  for (std::size_t c = 0; c < cameras.shape(0); ++c) {
    check::positive("cameras", cameras.data()[c * CAMERA_NUMBERS]);
    check::positive("cameras", cameras.data()[c * CAMERA_NUMBERS + 1]);
  }
}

}  // namespace

Triangulated triangulate_points(In<double, 4> pixels, std::optional<In<double, 3>> confidences,
                                In<double, 2> cameras, In<bool, 2> active, In<double, 1> noise,
                                double gate, double condition, bool detailed) {
  check_views(pixels, cameras);
  const std::size_t F = pixels.shape(0), C = pixels.shape(1), M = pixels.shape(2);
  if (confidences) check::shape("confidences", *confidences, {F, C, M});
  check::shape("active", active, {F, C});
  check::shape("noise", noise, {C});
  for (std::size_t c = 0; c < C; ++c) check::positive("noise", noise.data()[c]);
  check::positive("gate", gate);
  check::positive("condition", condition);
  const double* trust = confidences ? confidences->data() : nullptr;

  const std::size_t kept = detailed ? F : 0;
  Out<double, 3> points(F, M, 3), numbers(F, M, POINT_NUMBERS), tallies(F, C, TALLIES);
  Out<float, 4> residuals(kept, C, M, 2);
  Out<std::uint8_t, 3> states(kept, C, M);
  const std::vector<Camera> views = read_cameras(cameras, noise.data());
  std::fill_n(residuals.get(), kept * C * M * 2, std::numeric_limits<float>::quiet_NaN());
  std::fill_n(tallies.get(), F * C * TALLIES, 0.0);
  Point point;
  point.gate = gate * gate;
  std::array<std::uint8_t, 256> state;
  for (std::size_t f = 0; f < F; ++f)
    for (std::size_t m = 0; m < M; ++m) {
      double* const sums = tallies.get() + f * C * TALLIES;
      const auto pixel = [&](std::size_t c) { return pixels.data() + 2 * ((f * C + c) * M + m); };
      point.count = 0;
      std::size_t visible = 0;
      for (std::size_t c = 0; c < C; ++c) {
        const double u = pixel(c)[0], v = pixel(c)[1];
        const double confidence = trust ? trust[(f * C + c) * M + m] : 1;
        state[c] = UNSEEN;
        if (!(std::isfinite(u) && std::isfinite(v) && confidence > 0 && std::isfinite(confidence)))
          continue;
        CameraView& s = point.views[point.count];
        sums[c * TALLIES] += 1, sums[c * TALLIES + 7] += views[c].outside(u, v);
        if (!views[c].ray(u, v, s.x, s.y)) {
          state[c] = NO_RAY, sums[c * TALLIES + 4] += 1;
          continue;
        }
        ++visible;
        if (!active.data()[f * C + c]) {
          state[c] = INACTIVE;
          continue;
        }
        state[c] = UNRESOLVED;
        s.camera = &views[c], s.number = c, s.u = u, s.v = v, s.used = true;
        s.weight = views[c].information * confidence;
        ++point.count;
      }
      Solution solution = point.count < 2 ? Solution{} : point.solve_robust();
      const std::size_t used = solution.converged ? point.used() : 0;
      const double trace = solution.converged ? solution.factor.trace() : 0;
      // Nearly parallel rays have no depth.
      if (used < 2 || !(trace * solution.trace <= condition)) solution = Solution{};

      double* to = points.get() + (f * M + m) * 3;
      double* more = numbers.get() + (f * M + m) * POINT_NUMBERS;
      to[0] = solution.point.x, to[1] = solution.point.y, to[2] = solution.point.z;
      more[0] = more[1] = more[2] = NAN_VALUE;
      more[3] = solution.converged ? static_cast<double>(used) : 0,
      more[4] = static_cast<double>(visible);
      if (solution.converged) {
        double pixel_squares = 0, squares = 0;
        const auto judge = [&](CameraView& s, bool known, std::uint8_t as) {
          double* const sum = sums + s.number * TALLIES;
          state[s.number] = as, sum[2] += 1;
          if (detailed && known) {
            float* at = residuals.get() + 2 * ((f * C + s.number) * M + m);
            at[0] = static_cast<float>(s.ru), at[1] = static_cast<float>(s.rv);
          }
          if (as != USED) {
            sum[3] += as == REJECTED || !known || s.squared() > point.gate;
            return;
          }
          const double scale = 2 * s.depth / (s.camera->fx + s.camera->fy);
          const double square = s.ru * s.ru + s.rv * s.rv, metric = square * scale * scale;
          sum[1] += 1, sum[5] += square, sum[6] += metric;
          pixel_squares += square, squares += metric;
        };
        for (std::size_t i = 0; i < point.count; ++i) {
          CameraView& s = point.views[i];
          const bool known = s.used || s.project(solution.point);
          judge(s, known, s.used ? USED : REJECTED);
        }
        for (std::size_t c = 0; visible > point.count && c < C; ++c) {
          if (state[c] != INACTIVE) continue;
          CameraView s{};
          s.camera = &views[c], s.number = c, s.u = pixel(c)[0], s.v = pixel(c)[1];
          s.weight = views[c].information;
          judge(s, s.project(solution.point), INACTIVE);
        }
        more[0] = std::sqrt(pixel_squares / more[3]), more[1] = std::sqrt(squares / more[3]);
        more[2] = std::sqrt(trace);
      }
      for (std::size_t c = 0; detailed && c < C; ++c) states.get()[(f * C + c) * M + m] = state[c];
    }
  return {std::move(points), std::move(numbers), std::move(tallies), std::move(residuals),
          std::move(states)};
}

Out<double, 2> least_median_residuals(In<double, 4> pixels, In<double, 2> cameras) {
  check_views(pixels, cameras);
  const std::size_t F = pixels.shape(0), C = pixels.shape(1), M = pixels.shape(2);
  Out<double, 2> medians(F, M);
  const std::vector<Camera> views = read_cameras(cameras, nullptr);
  Point point;
  for (std::size_t f = 0; f < F; ++f)
    for (std::size_t m = 0; m < M; ++m) {
      point.count = 0;
      for (std::size_t c = 0; c < C; ++c) {
        const double* at = pixels.data() + 2 * ((f * C + c) * M + m);
        CameraView& s = point.views[point.count];
        if (!(std::isfinite(at[0]) && std::isfinite(at[1]))) continue;
        if (!views[c].ray(at[0], at[1], s.x, s.y)) continue;
        s.camera = &views[c], s.u = at[0], s.v = at[1], s.weight = 1, s.used = true;
        ++point.count;
      }
      medians.get()[f * M + m] = point.count < 2 ? NAN_VALUE : std::sqrt(point.least_median());
    }
  return medians;
}

}  // namespace animtool
