// Scalar curves: segments between keys, evaluated at many times.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/checks.h"
#include "curves/curves.h"

namespace animtool {

namespace {

enum SegmentKind : std::int64_t { kHold = 0, kLinear = 1, kCubic = 2, kBezier = 3 };

// The polynomial p1 u + p2 u^2 + p3 u^3, and its derivatives.
struct Cubic {
  double p1, p2, p3;

  double value(double u) const { return u * (p1 + u * (p2 + u * p3)); }
  double derivative(double u) const { return p1 + u * (2 * p2 + u * (3 * p3)); }
  double second_derivative(double u) const { return 2 * p2 + u * (6 * p3); }
};

// The half of a segment next to a key. Time and value are relative to that key, so that nothing
// cancels near it: u is 0 at the key, and 1 at the other key.
struct HalfSegment {
  double key_time, span;  // time of the key; signed time to the other one
  double value;
  bool needs_solve;    // whether u has to be solved for, or is the time itself
  Cubic time;          // fraction of the span, as a function of u
  Cubic value_change;  // value relative to that at the key
};

// The Bezier polynomial from 0 to `end`, with two inner control values.
Cubic bezier(double first, double second, double end) {
  return {3 * first, 3 * (second - 2 * first), end + 3 * (first - second)};
}

// A handle as a fraction of the segment's length, and its value. A handle longer than the segment
// is shrunk to it; its slope stays.
struct Handle {
  Handle(const double* offset, double span)
      : length_ratio(std::fabs(offset[0]) / span), value_offset(offset[1]) {
    if (length_ratio > 1) {
      value_offset /= length_ratio;
      length_ratio = 1;
    }
  }
  double length_ratio, value_offset;
};

// A segment as two halves, one from each key; `middle` is the time at u = 1/2.
struct Segment {
  HalfSegment halves[2];
  double start, middle, end;
};

Segment make_segment(const double* times, const double* values, std::int64_t kind,
                     const double* out, const double* in) {
  const double span = times[1] - times[0], value_change = values[1] - values[0];
  HalfSegment first{times[0], span, values[0], false, {}, {}};
  HalfSegment second{times[1], -span, values[1], false, {}, {}};
  double middle = times[0] + 0.5 * span;
  if (kind == kHold) {
    second.value = values[0];
  } else if (kind == kLinear) {
    first.value_change = {value_change, 0, 0};
    second.value_change = {-value_change, 0, 0};
  } else if (kind == kCubic) {
    first.value_change = bezier(out[1], value_change + in[1], value_change);
    second.value_change = bezier(in[1], out[1] - value_change, -value_change);
  } else {
    const Handle a(out, span), b(in, span);
    first.needs_solve = second.needs_solve = true;
    first.time = bezier(a.length_ratio, 1 - b.length_ratio, 1);
    second.time = bezier(b.length_ratio, 1 - a.length_ratio, 1);
    first.value_change = bezier(a.value_offset, value_change + b.value_offset, value_change);
    second.value_change = bezier(b.value_offset, a.value_offset - value_change, -value_change);
    middle = times[0] + span * first.time.value(0.5);
  }
  return {{first, second}, times[0], middle, times[1]};
}

// The u at which the time polynomial is x, for any handles: Newton's method in a bracket, which is
// halved where it converges too slowly (W. H. Press et al., Numerical recipes, 3rd edition, 2007,
// section 9.4).
double solve_guarded(const Cubic& time, double x) {
  if (!(x > 0)) return 0;
  if (x >= 1) return 1;
  double low = 0, high = 1, u = 0.5;
  // Only the leading term, so that u starts with its order of magnitude.
  if (time.p1 > 0) u = std::min(u, x / time.p1);
  if (time.p2 > 0) u = std::min(u, std::sqrt(x / time.p2));
  if (time.p3 > 0) u = std::min(u, std::cbrt(x / time.p3));
  double previous_step = 1;
  for (int i = 0; i < 200; ++i) {
    const double residual = time.value(u) - x, derivative = time.derivative(u);
    if (residual == 0) return u;
    (residual < 0 ? low : high) = u;
    double step = -residual / derivative;
    const double next = u + step;
    if (!(next > low && next < high && std::fabs(step) <= 0.5 * previous_step)) {
      step = 0.5 * (high - low);
      if (low + step == u) return u;
      step += low - u;
    }
    previous_step = std::fabs(step);
    u += step;
    if (previous_step <= 1e-16 * u) return u;
  }
  return u;
}

// Number of times that are solved together.
constexpr std::size_t kTimesPerChunk = 64;

// The u of each x where Halley's method converges in a few steps; NaN elsewhere. Has no branches,
// so that the processor works on several at a time. Starts from the parabola with the cubic's slope
// at 0 that equals it at 1/2.
void solve_quickly(const Cubic& time, const double* x, double* u, std::size_t n) {
  const double p1 = time.p1, curvature = 4 * time.p2 + 2 * time.p3;
  for (std::size_t i = 0; i < n; ++i)
    u[i] = 2 * x[i] / (p1 + std::sqrt(std::max(p1 * p1 + curvature * x[i], 0.0)));
  const auto halley = [&time](double u, double x) {
    const double residual = time.value(u) - x, derivative = time.derivative(u);
    return 2 * residual * derivative /
           (2 * derivative * derivative - residual * time.second_derivative(u));
  };
  for (std::size_t i = 0; i < n; ++i) u[i] -= halley(u[i], x[i]);
  for (std::size_t i = 0; i < n; ++i) {
    const double previous = u[i] - halley(u[i], x[i]);
    const double step = halley(previous, x[i]), derivative = time.derivative(previous);
    const double second_derivative = time.second_derivative(previous);
    // The error after a step is its cube times ((second_derivative / 2 derivative)^2 - p3 /
    // derivative).
    const double error_bound =
        step * step * (second_derivative * second_derivative + 4 * derivative * std::fabs(time.p3));
    const bool has_converged =
        error_bound <= 1e-11 * derivative * derivative && std::fabs(step) <= 1e-5 * previous;
    u[i] = has_converged ? previous - step : NAN;
  }
}

// Values at times given as fractions from the key of the half segment.
void evaluate_half(const HalfSegment& half, const double* fractions, double* out, std::size_t n) {
  if (!half.needs_solve) {
    for (std::size_t i = 0; i < n; ++i) out[i] = half.value + half.value_change.value(fractions[i]);
    return;
  }
  double u[kTimesPerChunk];
  for (; n; fractions += kTimesPerChunk, out += kTimesPerChunk) {
    const std::size_t count = std::min(n, kTimesPerChunk);
    solve_quickly(half.time, fractions, u, count);
    for (std::size_t i = 0; i < count; ++i)
      if (!(u[i] >= 0)) u[i] = solve_guarded(half.time, fractions[i]);
    for (std::size_t i = 0; i < count; ++i) out[i] = half.value + half.value_change.value(u[i]);
    n -= count;
  }
}

// The number of leading times in [low, high).
std::size_t run_length(const double* times, std::size_t n, double low, double high) {
  std::size_t i = 0;
  while (i < n && times[i] >= low && times[i] < high) ++i;
  return i;
}

// Converts times to fractions of a span from a key.
void set_fractions(const double* times, double key_time, double span, double* out, std::size_t n) {
  for (std::size_t i = 0; i < n; ++i) out[i] = (times[i] - key_time) / span;
}

// Keys of all curves, or of one.
struct Keys {
  const double *times, *values;
  const std::int64_t* kinds;
  const double *ins, *outs;
  std::size_t count;

  Keys slice(std::size_t begin, std::size_t end) const {
    return {times + begin,   values + begin,   kinds + begin,
            ins + 2 * begin, outs + 2 * begin, end - begin};
  }
};

constexpr std::size_t OUTSIDE_KEYS = static_cast<std::size_t>(-1);

// Consecutive times in one half of a segment, or outside of the keys.
struct Run {
  std::size_t begin, end;
  std::size_t segment;      // index of its first key, or OUTSIDE_KEYS
  std::size_t nearest_key;  // index of the nearer key
};

// Finds the segments of times. Curves with keys at the same times share it.
class SegmentFinder {
 public:
  static constexpr std::size_t MAX_TIMES_PER_CALL = 1024;

  explicit SegmentFinder(const Keys& keys) : times_(keys.times), last_key_(keys.count - 1) {}

  // Finds the segments of at most MAX_TIMES_PER_CALL times, which mostly ascend.
  void find(const double* times, std::size_t n) {
    run_count_ = 0, key_count_ = 0;
    for (std::size_t f = 0; f < n;) {
      const double t = times[f];
      if (!(t >= times_[0] && t < times_[last_key_])) {
        const bool is_before_start = t < times_[0];
        const std::size_t begin = f++;
        while (f < n && (is_before_start ? times[f] < times_[0] : !(times[f] < times_[last_key_])))
          ++f;
        runs_[run_count_++] = {begin, f, OUTSIDE_KEYS, is_before_start ? 0 : last_key_};
        continue;
      }
      // Mostly it is the same segment or the next one.
      if (!(t >= times_[segment_] && t < times_[segment_ + 1])) {
        if (segment_ + 1 < last_key_ && t >= times_[segment_ + 1] && t < times_[segment_ + 2])
          ++segment_;
        else
          segment_ =
              static_cast<std::size_t>(std::upper_bound(times_, times_ + last_key_, t) - times_) -
              1;
      }
      const double start = times_[segment_], end = times_[segment_ + 1], span = end - start;
      const double middle = start + 0.5 * span;
      const bool is_second_half = t >= middle;
      const std::size_t length = run_length(times + f, n - f, is_second_half ? middle : start,
                                            is_second_half ? end : middle);
      set_fractions(times + f, is_second_half ? end : start, is_second_half ? -span : span,
                    fractions_ + f, length);
      runs_[run_count_++] = {f, f + length, segment_, segment_ + is_second_half};
      f += length;
    }
  }

  const Run* begin() const { return runs_; }
  const Run* end() const { return runs_ + run_count_; }
  // For each time in a segment: the time from the nearer key, as a fraction of the span to the
  // other key.
  const double* fractions() const { return fractions_; }

  // Whether runs are so short that linear segments are evaluated time by time instead.
  bool has_short_runs() const { return run_count_ && 4 * run_count_ >= runs_[run_count_ - 1].end; }

  // Interpolates a linear curve at all times, from the nearer and the farther key of each.
  void interpolate(const double* values, double* out) {
    if (!key_count_) find_keys();
    for (std::size_t i = 0; i < key_count_; ++i) {
      const double value = values[nearest_keys_[i]];
      out[i] = value + fractions_[i] * (values[farther_keys_[i]] - value);
    }
  }

 private:
  // Stores the nearer and the farther key of each time.
  void find_keys() {
    for (const Run& run : *this) {
      const bool is_outside = run.segment == OUTSIDE_KEYS;
      const std::size_t farther_key =
          is_outside ? run.nearest_key : 2 * run.segment + 1 - run.nearest_key;
      // The product is then -0, which keeps the sign of zero.
      if (is_outside) std::fill(fractions_ + run.begin, fractions_ + run.end, -0.0);
      std::fill(nearest_keys_ + run.begin, nearest_keys_ + run.end,
                static_cast<std::uint32_t>(run.nearest_key));
      std::fill(farther_keys_ + run.begin, farther_keys_ + run.end,
                static_cast<std::uint32_t>(farther_key));
    }
    key_count_ = runs_[run_count_ - 1].end;
  }

  const double* times_;
  std::size_t last_key_, segment_ = 0, run_count_ = 0;
  std::size_t key_count_ = 0;  // number of times whose keys are stored
  Run runs_[MAX_TIMES_PER_CALL];
  std::uint32_t nearest_keys_[MAX_TIMES_PER_CALL],
      farther_keys_[MAX_TIMES_PER_CALL];  // no curve has as many keys
  double fractions_[MAX_TIMES_PER_CALL];
};

// Evaluates times in a Bezier segment, whose middle depends on its handles.
void evaluate_bezier(const Segment& segment, const double* times, double* out, std::size_t n) {
  double fractions[SegmentFinder::MAX_TIMES_PER_CALL];
  for (std::size_t f = 0; f < n;) {
    const bool is_second_half = times[f] >= segment.middle;
    const HalfSegment& half = segment.halves[is_second_half];
    const std::size_t length =
        run_length(times + f, n - f, is_second_half ? segment.middle : segment.start,
                   is_second_half ? segment.end : segment.middle);
    set_fractions(times + f, half.key_time, half.span, fractions, length);
    evaluate_half(half, fractions, out + f, length);
    f += length;
  }
}

// Evaluates one curve; values are constant outside of its keys.
void evaluate_curve(const Keys& keys, bool is_linear, SegmentFinder& finder, const double* times,
                    double* out) {
  if (is_linear && finder.has_short_runs()) {
    finder.interpolate(keys.values, out);
    return;
  }
  for (const Run* run = finder.begin(); run < finder.end(); ++run) {
    const std::size_t f = run->begin, k = run->segment, n = run->end - f;
    const double value = keys.values[run->nearest_key];
    if (k == OUTSIDE_KEYS) {
      std::fill_n(out + f, n, value);
      continue;
    }
    const std::int64_t kind = keys.kinds[k];
    if (kind == kHold) {
      std::fill_n(out + f, n, keys.values[k]);
    } else if (kind == kLinear) {
      const double value_change = keys.values[k + 1] - keys.values[k];
      const double signed_change = run->nearest_key == k ? value_change : -value_change;
      for (std::size_t i = f; i < f + n; ++i)
        out[i] = value + finder.fractions()[i] * signed_change;
    } else {
      const Segment segment = make_segment(keys.times + k, keys.values + k, kind, keys.outs + 2 * k,
                                           keys.ins + 2 * (k + 1));
      if (kind == kCubic) {
        evaluate_half(segment.halves[run->nearest_key != k], finder.fractions() + f, out + f, n);
        continue;
      }
      while (run + 1 < finder.end() && run[1].segment == k) ++run;
      evaluate_bezier(segment, times + f, out + f, run->end - f);
    }
  }
}

[[noreturn]] void refuse_curve(const char* name, std::size_t curve, const char* message) {
  check::refuse(name, "curve " + check::text(curve) + ": " + message);
}

// Checks the keys of a curve. The last key starts no segment. Handles are checked only where a
// segment uses them. Returns whether all segments are linear.
bool check_curve(const Keys& keys, std::size_t curve, bool are_times_checked) {
  const std::size_t segment_count = keys.count - 1;
  if (!are_times_checked) {
    // Times in between are finite if the ends are, and no segment is longer than the curve.
    if (!std::isfinite(keys.times[segment_count] - keys.times[0]))
      refuse_curve("times", curve, "not finite");
    std::uint64_t has_unordered_times = 0;
    for (std::size_t k = 0; k < segment_count; ++k)
      has_unordered_times |= !(keys.times[k] < keys.times[k + 1]);
    if (has_unordered_times) refuse_curve("times", curve, "not ascending");
  }
  check::finite("values", keys.values, keys.count);
  std::uint64_t kind_bits = 0, shared_kind_bits = kLinear;
  for (std::size_t k = 0; k < segment_count; ++k) {
    const auto kind = static_cast<std::uint64_t>(keys.kinds[k]);
    kind_bits |= kind, shared_kind_bits &= kind;
  }
  if (kind_bits <= kLinear) return shared_kind_bits == kLinear;
  if (kind_bits > kBezier) check::indices("kinds", keys.kinds, segment_count, kHold, kBezier + 1);
  double out_sum = 0, in_sum = 0;  // NaN if a handle is not finite
  bool has_reversed_out = false, has_reversed_in = false;
  for (std::size_t k = 0; k < segment_count; ++k) {
    if (keys.kinds[k] <= kLinear) continue;
    const double *out = keys.outs + 2 * k, *in = keys.ins + 2 * (k + 1);
    out_sum += out[0] * 0 + out[1] * 0, in_sum += in[0] * 0 + in[1] * 0;
    const bool is_bezier = keys.kinds[k] == kBezier;
    has_reversed_out |= is_bezier && out[0] < 0, has_reversed_in |= is_bezier && in[0] > 0;
  }
  if (out_sum != 0) refuse_curve("outs", curve, "not finite");
  if (in_sum != 0) refuse_curve("ins", curve, "not finite");
  if (has_reversed_out) refuse_curve("outs", curve, "a handle points away from its segment");
  if (has_reversed_in) refuse_curve("ins", curve, "a handle points away from its segment");
  return false;
}

bool are_equal(const double* a, const double* b, std::size_t count) {
  return a == b || !std::memcmp(a, b, count * sizeof(double));
}

// Largest number of curves that are evaluated together: their keys stay in the processor's cache.
constexpr std::size_t MAX_GROUP_CURVES = 8;

}  // namespace

std::optional<Out<double, 2>> evaluate_curves(In<std::int64_t, 1> first, In<double, 1> times,
                                              In<double, 1> values, In<std::int64_t, 1> kinds,
                                              In<double, 2> ins, In<double, 2> outs,
                                              In<double, 2> at,
                                              std::optional<Filled<double, 2>> out) {
  const std::size_t count = times.shape(0), time_row_count = at.shape(0), frames = at.shape(1);
  check::shape("first", first, {check::ANY});
  check::shape("times", times, {check::ANY});
  check::starts("first", first, count);
  const std::size_t curve_count = first.shape(0) - 1;
  check::shape("values", values, {count});
  check::shape("kinds", kinds, {count});
  check::shape("ins", ins, {count, 2});
  check::shape("outs", outs, {count, 2});
  check::shape("at", at, {time_row_count == 1 ? 1 : curve_count, check::ANY});
  if (out) check::shape("out", *out, {curve_count, frames});
  const Keys keys_of_all_curves{times.data(), values.data(), kinds.data(),
                                ins.data(),   outs.data(),   count};
  const auto keys_of = [&](std::size_t c) {
    return keys_of_all_curves.slice(static_cast<std::size_t>(first.data()[c]),
                                    static_cast<std::size_t>(first.data()[c + 1]));
  };
  const auto times_of = [&](std::size_t c) {
    return at.data() + (time_row_count == 1 ? 0 : c * frames);
  };
  for (std::size_t c = 0; c < curve_count; ++c)
    if (!keys_of(c).count) refuse_curve("first", c, "it has no key");
  std::optional<Out<double, 2>> new_values;
  if (!out) new_values.emplace(curve_count, frames);
  double* const result = out ? out->data() : new_values->get();
  for (std::size_t c = 0, next; c < curve_count; c = next) {
    const Keys keys = keys_of(c);
    bool is_linear[MAX_GROUP_CURVES];
    is_linear[0] = check_curve(keys, c, false);
    for (next = c + 1; next < curve_count && next < c + MAX_GROUP_CURVES; ++next) {
      const Keys other = keys_of(next);
      if (other.count != keys.count || !are_equal(other.times, keys.times, keys.count) ||
          !are_equal(times_of(next), times_of(c), frames))
        break;
      is_linear[next - c] = check_curve(other, next, true);
    }
    SegmentFinder finder(keys);
    for (std::size_t f = 0; f < frames; f += SegmentFinder::MAX_TIMES_PER_CALL) {
      finder.find(times_of(c) + f, std::min(SegmentFinder::MAX_TIMES_PER_CALL, frames - f));
      for (std::size_t i = c; i < next; ++i)
        evaluate_curve(keys_of(i), is_linear[i - c], finder, times_of(c) + f,
                       result + i * frames + f);
    }
  }
  return new_values;
}

}  // namespace animtool
