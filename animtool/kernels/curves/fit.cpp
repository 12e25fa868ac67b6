// Sparse cubic segments through dense samples, within a bound at every sample.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "base/checks.h"
#include "curves/curves.h"

namespace animtool {

namespace {

// A segment is a cubic in Bernstein form over the samples from `start` to `end`. Its ends are
// samples; its inner control values are stored as offsets from the first sample.
struct Segment {
  std::size_t start, end;
  std::vector<double> first, second;
};

// Normal equations of the two inner control values: the matrix, and the right-hand side of each
// component.
struct NormalEquations {
  double first = 0, mixed = 0, second = 0;
  std::vector<double> right_first, right_second;
};

// Fits segments to samples.
class Fitter {
 public:
  // `low` and `high` (D,) limit each component of a segment, except at samples beyond them.
  // `straight_counts` (F,) counts the frames before each frame from which a straight segment leads
  // to the next frame.
  Fitter(const double* values, const double* bounds, const double* low, const double* high,
         const std::vector<std::size_t>& straight_counts, std::size_t width)
      : values_(values),
        bounds_(bounds),
        low_(low),
        high_(high),
        straight_counts_(straight_counts),
        width_(width) {
    normal_equations_.right_first.resize(width);
    normal_equations_.right_second.resize(width);
  }

  // Fits a segment by least squares, weighted by the bounds; returns whether it is within the
  // bounds. If it nearly is, weights grow with the errors (C. L. Lawson, 1961), which leads from
  // least squares towards the smallest largest error.
  bool fit(std::size_t a, std::size_t b, Segment& s) {
    init_linear(a, b, s);
    if (b - a == 1) return true;
    if (is_straight(s)) return false;
    accumulate(s, normal_equations_);
    solve(s, normal_equations_);
    clamp_to_range(s);
    double max_error = compute_max_error(s);
    if (max_error <= kMaxError) return true;
    if (b - a <= kExactLength || max_error > kHopelessError) return false;
    error_weights_.assign(b - a + 1, 1.0);
    for (int iteration = 0; iteration < kMaxReweights; ++iteration) {
      reweight(s);
      accumulate(s, normal_equations_, error_weights_.data());
      solve(s, normal_equations_);
      clamp_to_range(s);
      const double new_error = compute_max_error(s);
      if (new_error <= kMaxError) return true;
      // Convergence is linear: a small gain will not reach the bound.
      if (new_error > max_error * kMaxImprovingRatio && iteration > 0) return false;
      max_error = std::min(max_error, new_error);
    }
    return false;
  }

  // Fits the longest segment from a, at most to b, that galloping and bisection find.
  void fit_longest(std::size_t a, std::size_t b, Segment& best_segment) {
    Segment trial_segment;
    std::size_t fitting_length = 1, failing_length = b - a + 1;
    fit(a, a + 1, best_segment);
    for (std::size_t n = kExactLength; fitting_length < b - a && failing_length > b - a; n *= 2) {
      const std::size_t length = std::min(n, b - a);
      if (!fit(a, a + length, trial_segment)) {
        failing_length = length;
      } else {
        fitting_length = length;
        std::swap(best_segment, trial_segment);
      }
    }
    while (failing_length - fitting_length > 1) {
      const std::size_t length = fitting_length + (failing_length - fitting_length) / 2;
      if (!fit(a, a + length, trial_segment)) {
        failing_length = length;
      } else {
        fitting_length = length;
        std::swap(best_segment, trial_segment);
      }
    }
  }

  // Gives the key between two segments the same slope on both sides, if the bounds allow; returns
  // whether they do. With `keeps_start_slope`, the slope at the start of the left segment stays.
  bool smooth_key(Segment& left, bool keeps_start_slope, Segment& right) {
    if (is_straight(left) || is_straight(right)) return false;
    const double left_third = static_cast<double>(left.end - left.start) / 3;
    const double right_third = static_cast<double>(right.end - right.start) / 3;
    const double* key = row(left.end);
    const double *left_start = row(left.start), *right_end = row(right.end);
    NormalEquations left_equations = normal_equations_, right_equations = normal_equations_;
    accumulate(left, left_equations);
    accumulate(right, right_equations);
    const double left_stiffness = stiffness(left_equations.second, left_equations.mixed,
                                            keeps_start_slope ? 0.0 : left_equations.first) *
                                  left_third * left_third;
    const double right_stiffness =
        stiffness(right_equations.first, right_equations.mixed, right_equations.second) *
        right_third * right_third;
    const double fraction = left_stiffness + right_stiffness > 0
                                ? left_stiffness / (left_stiffness + right_stiffness)
                                : 0.5;
    for (const double weight : {fraction, 0.5, 0.0, 1.0}) {
      Segment new_left = left, new_right = right;
      for (std::size_t d = 0; d < width_; ++d) {
        const double chord = key[d] - left_start[d];
        const double in = (chord - left.second[d]) / left_third;
        const double out = right.first[d] / right_third;
        const double slope = weight * in + (1 - weight) * out;
        new_left.second[d] = chord - slope * left_third;
        new_right.first[d] = slope * right_third;
        if (!keeps_start_slope)
          new_left.first[d] =
              left_equations.first > 0
                  ? (left_equations.right_first[d] - left_equations.mixed * new_left.second[d]) /
                        left_equations.first
                  : chord / 3;
        new_right.second[d] =
            right_equations.second > 0
                ? (right_equations.right_second[d] - right_equations.mixed * new_right.first[d]) /
                      right_equations.second
                : (right_end[d] - key[d]) * (2.0 / 3);
      }
      if (compute_max_error(new_left) <= kMaxError && compute_max_error(new_right) <= kMaxError &&
          is_in_range(new_left) && is_in_range(new_right)) {
        std::swap(left, new_left);
        std::swap(right, new_right);
        return true;
      }
    }
    return false;
  }

  // Whether every sample is within its bound of the first.
  bool is_constant(std::size_t frames) {
    for (std::size_t i = 1; i < frames; ++i) {
      double sum = 0;
      for (std::size_t d = 0; d < width_; ++d) {
        const double difference = row(i)[d] - values_[d];
        sum += difference * difference;
      }
      if (sum > bounds_[i] * bounds_[i]) return false;
    }
    return true;
  }

 private:
  static constexpr std::size_t kExactLength = 3;  // two inner samples, two control values
  // Largest error over its bound: not quite 1, because handles are rounded when they are stored.
  static constexpr double kMaxError = 1 - 1e-9;
  static constexpr double kHopelessError = 1.6;
  static constexpr double kMaxImprovingRatio = 0.97;
  static constexpr int kMaxReweights = 4;

  const double* row(std::size_t i) const { return values_ + i * width_; }

  bool is_straight(const Segment& s) const {
    return straight_counts_[s.end] > straight_counts_[s.start];
  }

  // Range of a component of a segment, relative to its first sample.
  struct ValueRange {
    double low, high;
    bool contains(double offset) const { return offset >= low && offset <= high; }
  };

  ValueRange allowed_range(const Segment& s, std::size_t d) const {
    const double from = row(s.start)[d], to = row(s.end)[d];
    return {std::min({low_[d] - from, 0.0, to - from}),
            std::max({high_[d] - from, 0.0, to - from})};
  }

  // Whether a component stays in its range: tests its control values, else its extrema.
  bool is_in_range(const Segment& s, std::size_t d) const {
    const ValueRange range = this->allowed_range(s, d);
    const double f = s.first[d], g = s.second[d], w = row(s.end)[d] - row(s.start)[d];
    if (range.contains(f) && range.contains(g)) return true;
    // f (1 - u)^2 + 2 (g - f) u (1 - u) + (w - g) u^2 = 0
    const double a = w - 3 * g + 3 * f, b = 2 * g - 4 * f, c = f;
    const double discriminant = b * b - 4 * a * c;
    if (discriminant < 0) return true;
    const double q = -0.5 * (b + std::copysign(std::sqrt(discriminant), b));
    for (const double u : {a != 0 ? q / a : -1.0, q != 0 ? c / q : -1.0}) {
      if (!(u > 0 && u < 1)) continue;
      const double v = 1 - u;
      if (!range.contains(3 * u * v * v * f + 3 * u * u * v * g + u * u * u * w)) return false;
    }
    return true;
  }

  bool is_in_range(const Segment& s) const {
    for (std::size_t d = 0; d < width_; ++d)
      if (!is_in_range(s, d)) return false;
    return true;
  }

  // Clamps control values to the range of their components, which keeps the curve in it.
  void clamp_to_range(Segment& s) const {
    for (std::size_t d = 0; d < width_; ++d) {
      if (is_in_range(s, d)) continue;
      const ValueRange range = this->allowed_range(s, d);
      s.first[d] = std::clamp(s.first[d], range.low, range.high);
      s.second[d] = std::clamp(s.second[d], range.low, range.high);
    }
  }

  // Starts with a straight segment.
  void init_linear(std::size_t a, std::size_t b, Segment& s) {
    s.start = a;
    s.end = b;
    s.first.resize(width_);
    s.second.resize(width_);
    for (std::size_t d = 0; d < width_; ++d) {
      const double third = (row(b)[d] - row(a)[d]) / 3;
      s.first[d] = third;
      s.second[d] = 2 * third;
    }
  }

  // Accumulates the normal equations of a segment.
  void accumulate(const Segment& s, NormalEquations& sums,
                  const double* extra_weights = nullptr) const {
    const double step = 1.0 / static_cast<double>(s.end - s.start);
    const double *from = row(s.start), *to = row(s.end);
    double first = 0, mixed = 0, second = 0;
    std::fill(sums.right_first.begin(), sums.right_first.end(), 0.0);
    std::fill(sums.right_second.begin(), sums.right_second.end(), 0.0);
    for (std::size_t i = s.start + 1; i < s.end; ++i) {
      const double u = static_cast<double>(i - s.start) * step, v = 1 - u;
      const double b1 = 3 * u * v * v, b2 = 3 * u * u * v, b3 = u * u * u;
      double weight = 1 / (bounds_[i] * bounds_[i]);
      if (extra_weights) weight *= extra_weights[i - s.start];
      const double w1 = weight * b1, w2 = weight * b2;
      first += w1 * b1;
      mixed += w1 * b2;
      second += w2 * b2;
      for (std::size_t d = 0; d < width_; ++d) {
        const double remainder = (row(i)[d] - from[d]) - b3 * (to[d] - from[d]);
        sums.right_first[d] += w1 * remainder;
        sums.right_second[d] += w2 * remainder;
      }
    }
    sums.first = first;
    sums.mixed = mixed;
    sums.second = second;
  }

  void solve(Segment& s, const NormalEquations& n) const {
    if (s.end - s.start == 2) {
      // One inner sample: the parabola through it; both control values move equally.
      for (std::size_t d = 0; d < width_; ++d) {
        const double chord = row(s.end)[d] - row(s.start)[d];
        const double difference = (row(s.start + 1)[d] - row(s.start)[d]) - chord / 2;
        s.first[d] = chord / 3 + difference * (4.0 / 3);
        s.second[d] = chord * (2.0 / 3) + difference * (4.0 / 3);
      }
      return;
    }
    const double determinant = n.first * n.second - n.mixed * n.mixed;
    for (std::size_t d = 0; d < width_; ++d) {
      s.first[d] = (n.right_first[d] * n.second - n.right_second[d] * n.mixed) / determinant;
      s.second[d] = (n.right_second[d] * n.first - n.right_first[d] * n.mixed) / determinant;
    }
  }

  // The squared error at a sample, over its bound.
  double squared_error(const Segment& s, std::size_t i, double step) const {
    const double u = static_cast<double>(i - s.start) * step, v = 1 - u;
    const double b1 = 3 * u * v * v, b2 = 3 * u * u * v, b3 = u * u * u;
    const double *from = row(s.start), *to = row(s.end), *sample = row(i);
    double sum = 0;
    for (std::size_t d = 0; d < width_; ++d) {
      const double e =
          (sample[d] - from[d]) - b3 * (to[d] - from[d]) - b1 * s.first[d] - b2 * s.second[d];
      sum += e * e;
    }
    return sum / (bounds_[i] * bounds_[i]);
  }

  // The largest error over its bound; a larger value once the error is hopeless.
  double compute_max_error(const Segment& s) const {
    const double step = 1.0 / static_cast<double>(s.end - s.start);
    double max_squared = 0;
    for (std::size_t i = s.start + 1; i < s.end; ++i) {
      const double error = squared_error(s, i, step);
      if (!(error <= max_squared)) max_squared = error;
      if (!(max_squared <= kHopelessError * kHopelessError)) return 2 * kHopelessError;
    }
    return std::sqrt(max_squared);
  }

  // Multiplies weights by the errors.
  void reweight(const Segment& s) {
    const double step = 1.0 / static_cast<double>(s.end - s.start);
    double sum = 0;
    for (std::size_t i = s.start + 1; i < s.end; ++i) {
      double& weight = error_weights_[i - s.start];
      weight *= std::sqrt(squared_error(s, i, step)) + 1e-3;
      sum += weight;
    }
    const double scale = static_cast<double>(s.end - s.start) / sum;
    for (double& weight : error_weights_) weight *= scale;
  }

  // Stiffness of one control value, with the other one free.
  static double stiffness(double diagonal, double mixed, double other) {
    const double remaining = other > 0 ? diagonal - mixed * mixed / other : diagonal;
    return remaining > 1e-9 * diagonal ? remaining : 0.0;
  }

  const double* values_;
  const double* bounds_;
  const double* low_;
  const double* high_;
  const std::vector<std::size_t>& straight_counts_;
  std::size_t width_;
  std::vector<double> error_weights_;
  NormalEquations normal_equations_;
};

}  // namespace

CubicFit fit_cubics(In<double, 2> values, In<double, 1> bounds, In<std::int64_t, 1> anchors,
                    In<double, 1> low, In<double, 1> high, In<std::int64_t, 1> straight_frames) {
  const std::size_t frames = values.shape(0), width = values.shape(1);
  check::shape("values", values, {check::ANY, check::ANY});
  check::shape("bounds", bounds, {frames});
  check::shape("anchors", anchors, {check::ANY});
  check::shape("low", low, {width});
  check::shape("high", high, {width});
  for (std::size_t d = 0; d < width; ++d)
    if (!(low.data()[d] <= high.data()[d]))
      check::refuse("low", "it is not at most high at index " + check::text(d));
  if (!frames || !width) check::refuse("values", "the array is empty");
  check::finite("values", values);
  for (std::size_t i = 0; i < frames; ++i) check::positive("bounds", bounds.data()[i]);
  const std::int64_t* anchor = anchors.data();
  check::indices("anchors", anchors, 1, static_cast<std::int64_t>(frames) - 1);
  for (std::size_t k = 1; k < anchors.shape(0); ++k)
    if (anchor[k] <= anchor[k - 1])
      check::refuse("anchors", "it does not ascend at index " + check::text(k));
  check::indices("straight_frames", straight_frames, 0, static_cast<std::int64_t>(frames));
  std::vector<std::size_t> straight_counts(frames + 1, 0);
  for (std::size_t k = 0; k < straight_frames.shape(0); ++k)
    straight_counts[straight_frames.data()[k] + 1] = 1;
  std::partial_sum(straight_counts.begin(), straight_counts.end(), straight_counts.begin());
  std::vector<Segment> segments;
  std::vector<char> is_smooth;
  bool is_constant;
  Fitter fitter(values.data(), bounds.data(), low.data(), high.data(), straight_counts, width);
  is_constant = fitter.is_constant(frames);
  if (!is_constant) {
    std::size_t a = 0;
    for (std::size_t k = 0; k <= anchors.shape(0); ++k) {
      const std::size_t end =
          k < anchors.shape(0) ? static_cast<std::size_t>(anchor[k]) : frames - 1;
      Segment single_segment;
      if (fitter.fit(a, end, single_segment)) {
        segments.push_back(std::move(single_segment));
        a = end;
      }
      while (a < end) {
        segments.emplace_back();
        fitter.fit_longest(a, end, segments.back());
        a = segments.back().end;
      }
    }
    is_smooth.assign(segments.size() + 1, 0);
    for (std::size_t k = 1; k < segments.size(); ++k)
      is_smooth[k] = fitter.smooth_key(segments[k - 1], is_smooth[k - 1], segments[k]);
  }
  const std::size_t key_count = is_constant ? 1 : segments.size() + 1;
  Out<std::int64_t, 1> key_frames(key_count);
  Out<double, 2> ins(key_count, width), outs(key_count, width);
  std::fill_n(ins.get(), key_count * width, 0.0);
  std::fill_n(outs.get(), key_count * width, 0.0);
  key_frames.get()[0] = 0;
  for (std::size_t k = 0; k + 1 < key_count; ++k) {
    const Segment& s = segments[k];
    key_frames.get()[k + 1] = static_cast<std::int64_t>(s.end);
    const double *from = values.data() + s.start * width, *to = values.data() + s.end * width;
    for (std::size_t d = 0; d < width; ++d) {
      outs.get()[k * width + d] = s.first[d];
      ins.get()[(k + 1) * width + d] = s.second[d] - (to[d] - from[d]);
    }
  }
  return {std::move(key_frames), std::move(ins), std::move(outs)};
}

}  // namespace animtool
