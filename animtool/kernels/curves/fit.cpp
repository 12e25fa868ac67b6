// Sparse cubic segments through dense samples, within a bound at every sample.
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "base/checks.h"
#include "curves/curves.h"

namespace animtool {

namespace {

// A segment is a cubic in Bernstein form over even samples a to b. Its ends lie on
// the data; its inner control values are kept as offsets from the first sample.
struct Segment {
  std::size_t a, b;
  std::vector<double> first, second;
};

// Normal equations of the two inner control values: the matrix, and what the data
// ask for in each component.
struct Normal {
  double first = 0, mixed = 0, second = 0;
  std::vector<double> at_first, at_second;
};

class Fitter {
 public:
  // `low` and `high` (D,) are what no component of a segment goes beyond, but for samples
  // that do. `straight` (F,) counts the frames before each from which a straight segment
  // leads to the next.
  Fitter(const double* values, const double* bounds, const double* low, const double* high,
         const std::vector<std::size_t>& straight, std::size_t width)
      : values_(values),
        bounds_(bounds),
        low_(low),
        high_(high),
        straight_(straight),
        width_(width) {
    normal_.at_first.resize(width);
    normal_.at_second.resize(width);
  }

  // The segment of least squares, weighted by the bounds; whether it keeps them.
  // Where it nearly does, weights grow with the errors (C. L. Lawson, 1961), which
  // leads from least squares towards the least largest error.
  bool fit(std::size_t a, std::size_t b, Segment& s) {
    start(a, b, s);
    if (b - a == 1) return true;
    if (is_straight(s)) return false;
    gather(s, normal_);
    solve(s, normal_);
    confine(s);
    double worst = largest(s);
    if (worst <= kKept) return true;
    if (b - a <= kExact || worst > kHopeless) return false;
    lawson_.assign(b - a + 1, 1.0);
    for (int round = 0; round < kRounds; ++round) {
      reweigh(s);
      gather(s, normal_, lawson_.data());
      solve(s, normal_);
      confine(s);
      const double now = largest(s);
      if (now <= kKept) return true;
      // Convergence is linear: what gains little will not get there.
      if (now > worst * kGain && round > 0) return false;
      worst = std::min(worst, now);
    }
    return false;
  }

  // The longest segment from a, at most to b, that galloping and bisection find.
  void longest(std::size_t a, std::size_t b, Segment& best) {
    Segment trial;
    std::size_t good = 1, bad = b - a + 1;
    fit(a, a + 1, best);
    for (std::size_t n = kExact; good < b - a && bad > b - a; n *= 2) {
      const std::size_t length = std::min(n, b - a);
      if (!fit(a, a + length, trial)) {
        bad = length;
      } else {
        good = length;
        std::swap(best, trial);
      }
    }
    while (bad - good > 1) {
      const std::size_t length = good + (bad - good) / 2;
      if (!fit(a, a + length, trial)) {
        bad = length;
      } else {
        good = length;
        std::swap(best, trial);
      }
    }
  }

  // One slope on both sides of the key between two segments, if the bounds allow.
  // The start of the left one stays where it is if it is held.
  bool join(Segment& left, bool keep_end, Segment& right) {
    if (is_straight(left) || is_straight(right)) return false;
    const double before = static_cast<double>(left.b - left.a) / 3;
    const double behind = static_cast<double>(right.b - right.a) / 3;
    const double* at = row(left.b);
    const double *from = row(left.a), *to = row(right.b);
    Normal l = normal_, r = normal_;
    gather(left, l);
    gather(right, r);
    const double pull = stiffness(l.second, l.mixed, keep_end ? 0.0 : l.first) * before * before;
    const double push = stiffness(r.first, r.mixed, r.second) * behind * behind;
    const double fraction = pull + push > 0 ? pull / (pull + push) : 0.5;
    for (const double part : {fraction, 0.5, 0.0, 1.0}) {
      Segment p = left, n = right;
      for (std::size_t d = 0; d < width_; ++d) {
        const double chord = at[d] - from[d];
        const double in = (chord - left.second[d]) / before;
        const double out = right.first[d] / behind;
        const double slope = part * in + (1 - part) * out;
        p.second[d] = chord - slope * before;
        n.first[d] = slope * behind;
        if (!keep_end)
          p.first[d] = l.first > 0 ? (l.at_first[d] - l.mixed * p.second[d]) / l.first : chord / 3;
        n.second[d] = r.second > 0 ? (r.at_second[d] - r.mixed * n.first[d]) / r.second
                                   : (to[d] - at[d]) * (2.0 / 3);
      }
      if (largest(p) <= kKept && largest(n) <= kKept && confined(p) && confined(n)) {
        std::swap(left, p);
        std::swap(right, n);
        return true;
      }
    }
    return false;
  }

  // Whether every sample is within its bound of the first.
  bool rests(std::size_t frames) {
    for (std::size_t i = 1; i < frames; ++i) {
      double sum = 0;
      for (std::size_t d = 0; d < width_; ++d) {
        const double off = row(i)[d] - values_[d];
        sum += off * off;
      }
      if (sum > bounds_[i] * bounds_[i]) return false;
    }
    return true;
  }

 private:
  static constexpr std::size_t kExact = 3;  // two inner samples, two control values
  // Handles are rounded once more when they are stored, hence not quite 1.
  static constexpr double kKept = 1 - 1e-9;
  static constexpr double kHopeless = 1.6;
  static constexpr double kGain = 0.97;
  static constexpr int kRounds = 4;

  const double* row(std::size_t i) const { return values_ + i * width_; }

  bool is_straight(const Segment& s) const { return straight_[s.b] > straight_[s.a]; }

  // How far a component of a segment may go from its first sample.
  struct Room {
    double low, high;
    bool holds(double offset) const { return offset >= low && offset <= high; }
  };

  Room room(const Segment& s, std::size_t d) const {
    const double from = row(s.a)[d], to = row(s.b)[d];
    return {std::min({low_[d] - from, 0.0, to - from}),
            std::max({high_[d] - from, 0.0, to - from})};
  }

  // Whether a component stays in its room: where its control values do, or where it turns.
  bool confined(const Segment& s, std::size_t d) const {
    const Room room = this->room(s, d);
    const double f = s.first[d], g = s.second[d], w = row(s.b)[d] - row(s.a)[d];
    if (room.holds(f) && room.holds(g)) return true;
    // f (1 - u)^2 + 2 (g - f) u (1 - u) + (w - g) u^2 = 0
    const double a = w - 3 * g + 3 * f, b = 2 * g - 4 * f, c = f;
    const double under = b * b - 4 * a * c;
    if (under < 0) return true;
    const double q = -0.5 * (b + std::copysign(std::sqrt(under), b));
    for (const double u : {a != 0 ? q / a : -1.0, q != 0 ? c / q : -1.0}) {
      if (!(u > 0 && u < 1)) continue;
      const double v = 1 - u;
      if (!room.holds(3 * u * v * v * f + 3 * u * u * v * g + u * u * u * w)) return false;
    }
    return true;
  }

  bool confined(const Segment& s) const {
    for (std::size_t d = 0; d < width_; ++d)
      if (!confined(s, d)) return false;
    return true;
  }

  // Brings control values into the room of their components, which keeps the curve there.
  void confine(Segment& s) const {
    for (std::size_t d = 0; d < width_; ++d) {
      if (confined(s, d)) continue;
      const Room room = this->room(s, d);
      s.first[d] = std::clamp(s.first[d], room.low, room.high);
      s.second[d] = std::clamp(s.second[d], room.low, room.high);
    }
  }

  void start(std::size_t a, std::size_t b, Segment& s) {
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

  void gather(const Segment& s, Normal& sums, const double* extra = nullptr) const {
    const double step = 1.0 / static_cast<double>(s.b - s.a);
    const double *from = row(s.a), *to = row(s.b);
    double first = 0, mixed = 0, second = 0;
    std::fill(sums.at_first.begin(), sums.at_first.end(), 0.0);
    std::fill(sums.at_second.begin(), sums.at_second.end(), 0.0);
    for (std::size_t i = s.a + 1; i < s.b; ++i) {
      const double u = static_cast<double>(i - s.a) * step, v = 1 - u;
      const double b1 = 3 * u * v * v, b2 = 3 * u * u * v, b3 = u * u * u;
      double weight = 1 / (bounds_[i] * bounds_[i]);
      if (extra) weight *= extra[i - s.a];
      const double w1 = weight * b1, w2 = weight * b2;
      first += w1 * b1;
      mixed += w1 * b2;
      second += w2 * b2;
      for (std::size_t d = 0; d < width_; ++d) {
        const double left = (row(i)[d] - from[d]) - b3 * (to[d] - from[d]);
        sums.at_first[d] += w1 * left;
        sums.at_second[d] += w2 * left;
      }
    }
    sums.first = first;
    sums.mixed = mixed;
    sums.second = second;
  }

  void solve(Segment& s, const Normal& n) const {
    if (s.b - s.a == 2) {
      // One inner sample: the parabola through it, both control values moved alike.
      for (std::size_t d = 0; d < width_; ++d) {
        const double chord = row(s.b)[d] - row(s.a)[d];
        const double off = (row(s.a + 1)[d] - row(s.a)[d]) - chord / 2;
        s.first[d] = chord / 3 + off * (4.0 / 3);
        s.second[d] = chord * (2.0 / 3) + off * (4.0 / 3);
      }
      return;
    }
    const double determinant = n.first * n.second - n.mixed * n.mixed;
    for (std::size_t d = 0; d < width_; ++d) {
      s.first[d] = (n.at_first[d] * n.second - n.at_second[d] * n.mixed) / determinant;
      s.second[d] = (n.at_second[d] * n.first - n.at_first[d] * n.mixed) / determinant;
    }
  }

  // Error over bound at a sample of the segment, squared.
  double off(const Segment& s, std::size_t i, double step) const {
    const double u = static_cast<double>(i - s.a) * step, v = 1 - u;
    const double b1 = 3 * u * v * v, b2 = 3 * u * u * v, b3 = u * u * u;
    const double *from = row(s.a), *to = row(s.b), *at = row(i);
    double sum = 0;
    for (std::size_t d = 0; d < width_; ++d) {
      const double e =
          (at[d] - from[d]) - b3 * (to[d] - from[d]) - b1 * s.first[d] - b2 * s.second[d];
      sum += e * e;
    }
    return sum / (bounds_[i] * bounds_[i]);
  }

  // The largest error over its bound; once it is beyond hope, any such.
  double largest(const Segment& s) const {
    const double step = 1.0 / static_cast<double>(s.b - s.a);
    double worst = 0;
    for (std::size_t i = s.a + 1; i < s.b; ++i) {
      const double e = off(s, i, step);
      if (!(e <= worst)) worst = e;
      if (!(worst <= kHopeless * kHopeless)) return 2 * kHopeless;
    }
    return std::sqrt(worst);
  }

  void reweigh(const Segment& s) {
    const double step = 1.0 / static_cast<double>(s.b - s.a);
    double sum = 0;
    for (std::size_t i = s.a + 1; i < s.b; ++i) {
      double& weight = lawson_[i - s.a];
      weight *= std::sqrt(off(s, i, step)) + 1e-3;
      sum += weight;
    }
    const double scale = static_cast<double>(s.b - s.a) / sum;
    for (double& weight : lawson_) weight *= scale;
  }

  // How much one control value costs to move, the other free to follow.
  static double stiffness(double diagonal, double mixed, double other) {
    const double left = other > 0 ? diagonal - mixed * mixed / other : diagonal;
    return left > 1e-9 * diagonal ? left : 0.0;
  }

  const double* values_;
  const double* bounds_;
  const double* low_;
  const double* high_;
  const std::vector<std::size_t>& straight_;
  std::size_t width_;
  std::vector<double> lawson_;
  Normal normal_;
};

}  // namespace

FittedCubics fit_cubics(In<double, 2> values, In<double, 1> bounds, In<std::int64_t, 1> anchors,
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
  bool rests;
  Fitter fitter(values.data(), bounds.data(), low.data(), high.data(), counts, width);
  rests = fitter.rests(frames);
  if (!rests) {
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
        fitter.longest(a, end, segments.back());
        a = segments.back().b;
      }
    }
    smooth.assign(segments.size() + 1, 0);
    for (std::size_t k = 1; k < segments.size(); ++k)
      smooth[k] = fitter.join(segments[k - 1], smooth[k - 1], segments[k]);
  }
  const std::size_t keys = rests ? 1 : segments.size() + 1;
  Out<std::int64_t, 1> at(keys);
  Out<double, 2> ins(keys, width), outs(keys, width);
  std::fill_n(ins.get(), keys * width, 0.0);
  std::fill_n(outs.get(), keys * width, 0.0);
  at.get()[0] = 0;
  for (std::size_t k = 0; k + 1 < keys; ++k) {
    const Segment& s = segments[k];
    at.get()[k + 1] = static_cast<std::int64_t>(s.b);
    const double *from = values.data() + s.a * width, *to = values.data() + s.b * width;
    for (std::size_t d = 0; d < width; ++d) {
      outs.get()[k * width + d] = s.first[d];
      ins.get()[(k + 1) * width + d] = s.second[d] - (to[d] - from[d]);
    }
  }
  return {std::move(at), std::move(ins), std::move(outs)};
}

}  // namespace animtool
