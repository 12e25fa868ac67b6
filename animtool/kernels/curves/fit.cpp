// Sparse cubic segments through dense samples, within a bound at every sample.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "base/checks.h"
#include "curves/curves.h"

namespace animtool {

namespace {

// A segment is a cubic in Bernstein form over the samples a to b. Its ends are samples; its inner
// control values are stored as offsets from the first sample.
struct Segment {
  std::size_t a, b;
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
  // `straight` (F,) counts the frames before each frame from which a straight segment leads to the
  // next frame.
  Fitter(const double* values, const double* bounds, const double* low, const double* high,
         const std::vector<std::size_t>& straight, std::size_t width)
      : values_(values),
        bounds_(bounds),
        low_(low),
        high_(high),
        straight_(straight),
        width_(width) {
    normal_.right_first.resize(width);
    normal_.right_second.resize(width);
  }

  // Fits a segment by least squares, weighted by the bounds; returns whether it is within the
  // bounds. If it nearly is, weights grow with the errors (C. L. Lawson, 1961), which leads from
  // least squares towards the smallest largest error.
  bool fit(std::size_t a, std::size_t b, Segment& s) {
    init_linear(a, b, s);
    if (b - a == 1) return true;
    if (is_straight(s)) return false;
    accumulate(s, normal_);
    solve(s, normal_);
    clamp_to_range(s);
    double max_error = compute_max_error(s);
    if (max_error <= kMaxError) return true;
    if (b - a <= kExactLength || max_error > kHopelessError) return false;
    error_weights_.assign(b - a + 1, 1.0);
    for (int iteration = 0; iteration < kMaxReweights; ++iteration) {
      reweight(s);
      accumulate(s, normal_, error_weights_.data());
      solve(s, normal_);
      clamp_to_range(s);
      const double new_error = compute_max_error(s);
      if (new_error <= kMaxError) return true;
      // Convergence is linear: a small gain will not reach the bound.
      if (new_error > max_error * kMinGain && iteration > 0) return false;
      max_error = std::min(max_error, new_error);
    }
    return false;
  }

  // Fits the longest segment from a, at most to b, that galloping and bisection find.
  void fit_longest(std::size_t a, std::size_t b, Segment& best) {
    Segment trial;
    std::size_t fitting = 1, failing = b - a + 1;
    fit(a, a + 1, best);
    for (std::size_t n = kExactLength; fitting < b - a && failing > b - a; n *= 2) {
      const std::size_t length = std::min(n, b - a);
      if (!fit(a, a + length, trial)) {
        failing = length;
      } else {
        fitting = length;
        std::swap(best, trial);
      }
    }
    while (failing - fitting > 1) {
      const std::size_t length = fitting + (failing - fitting) / 2;
      if (!fit(a, a + length, trial)) {
        failing = length;
      } else {
        fitting = length;
        std::swap(best, trial);
      }
    }
  }

  // Gives the key between two segments the same slope on both sides, if the bounds allow; returns
  // whether they do. With `keep_end`, the slope at the start of the left segment stays.
  bool smooth_key(Segment& left, bool keep_end, Segment& right) {
    if (is_straight(left) || is_straight(right)) return false;
    const double left_third = static_cast<double>(left.b - left.a) / 3;
    const double right_third = static_cast<double>(right.b - right.a) / 3;
    const double* key = row(left.b);
    const double *left_start = row(left.a), *right_end = row(right.b);
    NormalEquations l = normal_, r = normal_;
    accumulate(left, l);
    accumulate(right, r);
    const double left_stiffness =
        stiffness(l.second, l.mixed, keep_end ? 0.0 : l.first) * left_third * left_third;
    const double right_stiffness =
        stiffness(r.first, r.mixed, r.second) * right_third * right_third;
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
        if (!keep_end)
          new_left.first[d] =
              l.first > 0 ? (l.right_first[d] - l.mixed * new_left.second[d]) / l.first : chord / 3;
        new_right.second[d] = r.second > 0
                                  ? (r.right_second[d] - r.mixed * new_right.first[d]) / r.second
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
  static constexpr double kMinGain = 0.97;
  static constexpr int kMaxReweights = 4;

  const double* row(std::size_t i) const { return values_ + i * width_; }

  bool is_straight(const Segment& s) const { return straight_[s.b] > straight_[s.a]; }

  // Range of a component of a segment, relative to its first sample.
  struct ValueRange {
    double low, high;
    bool contains(double offset) const { return offset >= low && offset <= high; }
  };

  ValueRange allowed_range(const Segment& s, std::size_t d) const {
    const double from = row(s.a)[d], to = row(s.b)[d];
    return {std::min({low_[d] - from, 0.0, to - from}),
            std::max({high_[d] - from, 0.0, to - from})};
  }

  // Whether a component stays in its range: tests its control values, else its extrema.
  bool is_in_range(const Segment& s, std::size_t d) const {
    const ValueRange range = this->allowed_range(s, d);
    const double f = s.first[d], g = s.second[d], w = row(s.b)[d] - row(s.a)[d];
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
    s.a = a;
    s.b = b;
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
    const double step = 1.0 / static_cast<double>(s.b - s.a);
    const double *from = row(s.a), *to = row(s.b);
    double first = 0, mixed = 0, second = 0;
    std::fill(sums.right_first.begin(), sums.right_first.end(), 0.0);
    std::fill(sums.right_second.begin(), sums.right_second.end(), 0.0);
    for (std::size_t i = s.a + 1; i < s.b; ++i) {
      const double u = static_cast<double>(i - s.a) * step, v = 1 - u;
      const double b1 = 3 * u * v * v, b2 = 3 * u * u * v, b3 = u * u * u;
      double weight = 1 / (bounds_[i] * bounds_[i]);
      if (extra_weights) weight *= extra_weights[i - s.a];
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
    if (s.b - s.a == 2) {
      // One inner sample: the parabola through it; both control values move equally.
      for (std::size_t d = 0; d < width_; ++d) {
        const double chord = row(s.b)[d] - row(s.a)[d];
        const double difference = (row(s.a + 1)[d] - row(s.a)[d]) - chord / 2;
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
    const double u = static_cast<double>(i - s.a) * step, v = 1 - u;
    const double b1 = 3 * u * v * v, b2 = 3 * u * u * v, b3 = u * u * u;
    const double *from = row(s.a), *to = row(s.b), *sample = row(i);
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
    const double step = 1.0 / static_cast<double>(s.b - s.a);
    double max_squared = 0;
    for (std::size_t i = s.a + 1; i < s.b; ++i) {
      const double error = squared_error(s, i, step);
      if (!(error <= max_squared)) max_squared = error;
      if (!(max_squared <= kHopelessError * kHopelessError)) return 2 * kHopelessError;
    }
    return std::sqrt(max_squared);
  }

  // Multiplies weights by the errors.
  void reweight(const Segment& s) {
    const double step = 1.0 / static_cast<double>(s.b - s.a);
    double sum = 0;
    for (std::size_t i = s.a + 1; i < s.b; ++i) {
      double& weight = error_weights_[i - s.a];
      weight *= std::sqrt(squared_error(s, i, step)) + 1e-3;
      sum += weight;
    }
    const double scale = static_cast<double>(s.b - s.a) / sum;
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
  const std::vector<std::size_t>& straight_;
  std::size_t width_;
  std::vector<double> error_weights_;
  NormalEquations normal_;
};

}  // namespace

CubicFit fit_cubics(In<double, 2> values, In<double, 1> bounds, In<std::int64_t, 1> anchors,
                    In<double, 1> low, In<double, 1> high, In<std::int64_t, 1> straight) {
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
  check::indices("straight", straight, 0, static_cast<std::int64_t>(frames));
  std::vector<std::size_t> counts(frames + 1, 0);
  for (std::size_t k = 0; k < straight.shape(0); ++k) counts[straight.data()[k] + 1] = 1;
  std::partial_sum(counts.begin(), counts.end(), counts.begin());
  std::vector<Segment> segments;
  std::vector<char> smooth;
  bool is_constant;
  Fitter fitter(values.data(), bounds.data(), low.data(), high.data(), counts, width);
  is_constant = fitter.is_constant(frames);
  if (!is_constant) {
    std::size_t a = 0;
    for (std::size_t k = 0; k <= anchors.shape(0); ++k) {
      const std::size_t end =
          k < anchors.shape(0) ? static_cast<std::size_t>(anchor[k]) : frames - 1;
      Segment chord;
      if (fitter.fit(a, end, chord)) {
        segments.push_back(std::move(chord));
        a = end;
      }
      while (a < end) {
        segments.emplace_back();
        fitter.fit_longest(a, end, segments.back());
        a = segments.back().b;
      }
    }
    smooth.assign(segments.size() + 1, 0);
    for (std::size_t k = 1; k < segments.size(); ++k)
      smooth[k] = fitter.smooth_key(segments[k - 1], smooth[k - 1], segments[k]);
  }
  const std::size_t keys = is_constant ? 1 : segments.size() + 1;
  Out<std::int64_t, 1> key_frames(keys);
  Out<double, 2> ins(keys, width), outs(keys, width);
  std::fill_n(ins.get(), keys * width, 0.0);
  std::fill_n(outs.get(), keys * width, 0.0);
  key_frames.get()[0] = 0;
  for (std::size_t k = 0; k + 1 < keys; ++k) {
    const Segment& s = segments[k];
    key_frames.get()[k + 1] = static_cast<std::int64_t>(s.b);
    const double *from = values.data() + s.a * width, *to = values.data() + s.b * width;
    for (std::size_t d = 0; d < width; ++d) {
      outs.get()[k * width + d] = s.first[d];
      ins.get()[(k + 1) * width + d] = s.second[d] - (to[d] - from[d]);
    }
  }
  return {std::move(key_frames), std::move(ins), std::move(outs)};
}

}  // namespace animtool
