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

  double at(double u) const { return u * (p1 + u * (p2 + u * p3)); }
  double slope(double u) const { return p1 + u * (2 * p2 + u * (3 * p3)); }
  double bend(double u) const { return 2 * p2 + u * (6 * p3); }
};

// The half of a segment next to a key. Both time and value are counted from that
// key, so that nothing cancels near it: u is 0 there and 1 at the other key.
struct Half {
  double key, span;  // time of the key; signed time to the other one
  double value;
  bool solve;  // whether u has to be solved for, or is the time itself
  Cubic time;  // of the span
  Cubic rise;  // from the value
};

// The Bezier polynomial from 0 by control values near and far to end.
Cubic bezier(double near, double far, double end) {
  return {3 * near, 3 * (far - 2 * near), end + 3 * (near - far)};
}

// A handle longer than the segment is shrunk to it, its slope kept; the length as
// a share of the segment.
struct Handle {
  Handle(const double* offset, double span)
      : length_ratio(std::fabs(offset[0]) / span), dv(offset[1]) {
    if (length_ratio > 1) {
      dv /= length_ratio;
      length_ratio = 1;
    }
  }
  double length_ratio, dv;
};

// A segment as two halves, one from each key; `middle` is the time at u = 1/2.
struct Segment {
  Half halves[2];
  double start, middle, end;
};

Segment make_segment(const double* times, const double* values, std::int64_t kind,
                     const double* out, const double* in) {
  const double span = times[1] - times[0], rise = values[1] - values[0];
  Half first{times[0], span, values[0], false, {}, {}};
  Half second{times[1], -span, values[1], false, {}, {}};
  double middle = times[0] + 0.5 * span;
  if (kind == kHold) {
    second.value = values[0];
  } else if (kind == kLinear) {
    first.rise = {rise, 0, 0};
    second.rise = {-rise, 0, 0};
  } else if (kind == kCubic) {
    first.rise = bezier(out[1], rise + in[1], rise);
    second.rise = bezier(in[1], out[1] - rise, -rise);
  } else {
    const Handle a(out, span), b(in, span);
    first.solve = second.solve = true;
    first.time = bezier(a.length_ratio, 1 - b.length_ratio, 1);
    second.time = bezier(b.length_ratio, 1 - a.length_ratio, 1);
    first.rise = bezier(a.dv, rise + b.dv, rise);
    second.rise = bezier(b.dv, a.dv - rise, -rise);
    middle = times[0] + span * first.time.at(0.5);
  }
  return {{first, second}, times[0], middle, times[1]};
}

// The u where the time polynomial is x, for any handles: Newton's method in a
// bracket, which it halves where it converges too slowly
// (W. H. Press et al., Numerical recipes, 3rd edition, 2007, section 9.4).
double solve_guarded(const Cubic& time, double x) {
  if (!(x > 0)) return 0;
  if (x >= 1) return 1;
  double low = 0, high = 1, u = 0.5;
  // The leading term alone, so that u starts at its order of magnitude.
  if (time.p1 > 0) u = std::min(u, x / time.p1);
  if (time.p2 > 0) u = std::min(u, std::sqrt(x / time.p2));
  if (time.p3 > 0) u = std::min(u, std::cbrt(x / time.p3));
  double last = 1;
  for (int i = 0; i < 200; ++i) {
    const double f = time.at(u) - x, slope = time.slope(u);
    if (f == 0) return u;
    (f < 0 ? low : high) = u;
    double step = -f / slope;
    const double to = u + step;
    if (!(to > low && to < high && std::fabs(step) <= 0.5 * last)) {
      step = 0.5 * (high - low);
      if (low + step == u) return u;
      step += low - u;
    }
    last = std::fabs(step);
    u += step;
    if (last <= 1e-16 * u) return u;
  }
  return u;
}

constexpr std::size_t kChunk = 64;

// The u of each x where Halley's method gets there in a few steps; NaN elsewhere.
// Without branches, so that the processor works on several at a time. The start is
// the parabola with the cubic's slope at 0 that meets it at 1/2.
void solve_quickly(const Cubic& time, const double* x, double* u, std::size_t n) {
  const double p1 = time.p1, curve = 4 * time.p2 + 2 * time.p3;
  for (std::size_t i = 0; i < n; ++i)
    u[i] = 2 * x[i] / (p1 + std::sqrt(std::max(p1 * p1 + curve * x[i], 0.0)));
  const auto halley = [&time](double u, double x) {
    const double f = time.at(u) - x, slope = time.slope(u);
    return 2 * f * slope / (2 * slope * slope - f * time.bend(u));
  };
  for (std::size_t i = 0; i < n; ++i) u[i] -= halley(u[i], x[i]);
  for (std::size_t i = 0; i < n; ++i) {
    const double before = u[i] - halley(u[i], x[i]);
    const double step = halley(before, x[i]), slope = time.slope(before);
    const double bend = time.bend(before);
    // What is left after a step is its cube times ((bend / 2 slope)^2 - p3 / slope).
    const double left = step * step * (bend * bend + 4 * slope * std::fabs(time.p3));
    const bool near = left <= 1e-11 * slope * slope && std::fabs(step) <= 1e-5 * before;
    u[i] = near ? before - step : NAN;
  }
}

// Values at times whose fractions from the key of the half are known.
void evaluate_half(const Half& half, const double* fractions, double* out, std::size_t n) {
  if (!half.solve) {
    for (std::size_t i = 0; i < n; ++i) out[i] = half.value + half.rise.at(fractions[i]);
    return;
  }
  double u[kChunk];
  for (; n; fractions += kChunk, out += kChunk) {
    const std::size_t count = std::min(n, kChunk);
    solve_quickly(half.time, fractions, u, count);
    for (std::size_t i = 0; i < count; ++i)
      if (!(u[i] >= 0)) u[i] = solve_guarded(half.time, fractions[i]);
    for (std::size_t i = 0; i < count; ++i) out[i] = half.value + half.rise.at(u[i]);
    n -= count;
  }
}

// The number of leading times in [low, high).
std::size_t run_length(const double* at, std::size_t n, double low, double high) {
  std::size_t i = 0;
  while (i < n && at[i] >= low && at[i] < high) ++i;
  return i;
}

void set_fractions(const double* at, double key, double span, double* out, std::size_t n) {
  for (std::size_t i = 0; i < n; ++i) out[i] = (at[i] - key) / span;
}

// Keys of all curves, and those of one.
struct Keys {
  const double *times, *values;
  const std::int64_t* kinds;
  const double *ins, *outs;
  std::size_t count;

  Keys part(std::size_t begin, std::size_t end) const {
    return {times + begin,   values + begin,   kinds + begin,
            ins + 2 * begin, outs + 2 * begin, end - begin};
  }
};

constexpr std::size_t OUTSIDE = static_cast<std::size_t>(-1);

// Consecutive times in one half of a segment, or outside of the keys.
struct Run {
  std::size_t begin, end;
  std::size_t segment;  // its first key, or OUTSIDE
  std::size_t nearer;   // the nearer key
};

// Which segments times are in. Curves with keys at the same times share it.
class Walk {
 public:
  static constexpr std::size_t MOST = 1024;

  explicit Walk(const Keys& keys) : times_(keys.times), last_(keys.count - 1) {}

  // Goes over at most MOST times, ascending mostly.
  void over(const double* at, std::size_t n) {
    size_ = 0, gathered_ = 0;
    for (std::size_t f = 0; f < n;) {
      const double t = at[f];
      if (!(t >= times_[0] && t < times_[last_])) {
        const bool before = t < times_[0];
        const std::size_t begin = f++;
        while (f < n && (before ? at[f] < times_[0] : !(at[f] < times_[last_]))) ++f;
        runs_[size_++] = {begin, f, OUTSIDE, before ? 0 : last_};
        continue;
      }
      // Mostly it is this segment or the next.
      if (!(t >= times_[at_] && t < times_[at_ + 1])) {
        if (at_ + 1 < last_ && t >= times_[at_ + 1] && t < times_[at_ + 2])
          ++at_;
        else
          at_ = static_cast<std::size_t>(std::upper_bound(times_, times_ + last_, t) - times_) - 1;
      }
      const double from = times_[at_], to = times_[at_ + 1], span = to - from;
      const double middle = from + 0.5 * span;
      const bool late = t >= middle;
      const std::size_t run = run_length(at + f, n - f, late ? middle : from, late ? to : middle);
      set_fractions(at + f, late ? to : from, late ? -span : span, fractions_ + f, run);
      runs_[size_++] = {f, f + run, at_, at_ + late};
      f += run;
    }
  }

  const Run* begin() const { return runs_; }
  const Run* end() const { return runs_ + size_; }
  // Of each time in a segment: the time from the nearer key, of the way to the other one.
  const double* fractions() const { return fractions_; }

  // Whether runs are so short that linear segments are evaluated time by time instead.
  bool is_dense() const { return size_ && 4 * size_ >= runs_[size_ - 1].end; }

  // Linear curves at all times, from the nearer and the farther key of each.
  void interpolate(const double* values, double* out) {
    if (!gathered_) gather();
    for (std::size_t i = 0; i < gathered_; ++i) {
      const double value = values[near_[i]];
      out[i] = value + fractions_[i] * (values[far_[i]] - value);
    }
  }

 private:
  void gather() {
    for (const Run& run : *this) {
      const bool outside = run.segment == OUTSIDE;
      const std::size_t far = outside ? run.nearer : 2 * run.segment + 1 - run.nearer;
      // The product is -0 there, which keeps the sign of zero.
      if (outside) std::fill(fractions_ + run.begin, fractions_ + run.end, -0.0);
      std::fill(near_ + run.begin, near_ + run.end, static_cast<std::uint32_t>(run.nearer));
      std::fill(far_ + run.begin, far_ + run.end, static_cast<std::uint32_t>(far));
    }
    gathered_ = runs_[size_ - 1].end;
  }

  const double* times_;
  std::size_t last_, at_ = 0, size_ = 0, gathered_ = 0;
  Run runs_[MOST];
  std::uint32_t near_[MOST], far_[MOST];  // no curve has as many keys
  double fractions_[MOST];
};

// Times in a Bezier segment, whose middle depends on its handles.
void evaluate_bezier(const Segment& segment, const double* at, double* out, std::size_t n) {
  double fractions[Walk::MOST];
  for (std::size_t f = 0; f < n;) {
    const bool late = at[f] >= segment.middle;
    const Half& half = segment.halves[late];
    const std::size_t run = run_length(at + f, n - f, late ? segment.middle : segment.start,
                                       late ? segment.end : segment.middle);
    set_fractions(at + f, half.key, half.span, fractions, run);
    evaluate_half(half, fractions, out + f, run);
    f += run;
  }
}

// One curve, held outside its keys.
void evaluate_curve(const Keys& keys, bool linear, Walk& walk, const double* at, double* out) {
  if (linear && walk.is_dense()) {
    walk.interpolate(keys.values, out);
    return;
  }
  for (const Run* run = walk.begin(); run < walk.end(); ++run) {
    const std::size_t f = run->begin, k = run->segment, n = run->end - f;
    const double value = keys.values[run->nearer];
    if (k == OUTSIDE) {
      std::fill_n(out + f, n, value);
      continue;
    }
    const std::int64_t kind = keys.kinds[k];
    if (kind == kHold) {
      std::fill_n(out + f, n, keys.values[k]);
    } else if (kind == kLinear) {
      const double rise = keys.values[k + 1] - keys.values[k];
      const double signed_rise = run->nearer == k ? rise : -rise;
      for (std::size_t i = f; i < f + n; ++i) out[i] = value + walk.fractions()[i] * signed_rise;
    } else {
      const Segment segment = make_segment(keys.times + k, keys.values + k, kind, keys.outs + 2 * k,
                                           keys.ins + 2 * (k + 1));
      if (kind == kCubic) {
        evaluate_half(segment.halves[run->nearer != k], walk.fractions() + f, out + f, n);
        continue;
      }
      while (run + 1 < walk.end() && run[1].segment == k) ++run;
      evaluate_bezier(segment, at + f, out + f, run->end - f);
    }
  }
}

[[noreturn]] void refuse(const char* name, std::size_t curve, const char* why) {
  check::refuse(name, "curve " + check::text(curve) + ": " + why);
}

// The last key of a curve begins no segment. Handles are looked at where a segment has them.
// Returns whether all segments are linear.
bool check_curve(const Keys& keys, std::size_t curve, bool times_known) {
  const std::size_t segments = keys.count - 1;
  if (!times_known) {
    // Those between are finite if the ends are, and no segment is longer than the curve.
    if (!std::isfinite(keys.times[segments] - keys.times[0])) refuse("times", curve, "not finite");
    std::uint64_t wrong = 0;
    for (std::size_t k = 0; k < segments; ++k) wrong |= !(keys.times[k] < keys.times[k + 1]);
    if (wrong) refuse("times", curve, "not ascending");
  }
  check::finite("values", keys.values, keys.count);
  std::uint64_t bits = 0, common = kLinear;
  for (std::size_t k = 0; k < segments; ++k) {
    const auto kind = static_cast<std::uint64_t>(keys.kinds[k]);
    bits |= kind, common &= kind;
  }
  if (bits <= kLinear) return common == kLinear;
  if (bits > kBezier) check::indices("kinds", keys.kinds, segments, kHold, kBezier + 1);
  double out_sum = 0, in_sum = 0;  // no numbers where a handle is not finite
  bool out_back = false, in_back = false;
  for (std::size_t k = 0; k < segments; ++k) {
    if (keys.kinds[k] <= kLinear) continue;
    const double *out = keys.outs + 2 * k, *in = keys.ins + 2 * (k + 1);
    out_sum += out[0] * 0 + out[1] * 0, in_sum += in[0] * 0 + in[1] * 0;
    const bool bezier = keys.kinds[k] == kBezier;
    out_back |= bezier && out[0] < 0, in_back |= bezier && in[0] > 0;
  }
  if (out_sum != 0) refuse("outs", curve, "not finite");
  if (in_sum != 0) refuse("ins", curve, "not finite");
  if (out_back) refuse("outs", curve, "a handle points away from its segment");
  if (in_back) refuse("ins", curve, "a handle points away from its segment");
  return false;
}

bool equal(const double* a, const double* b, std::size_t count) {
  return a == b || !std::memcmp(a, b, count * sizeof(double));
}

// Curves that are looked at together: their keys stay in the processor's cache.
constexpr std::size_t TOGETHER = 8;

}  // namespace

std::optional<Out<double, 2>> evaluate_curves(In<std::int64_t, 1> first, In<double, 1> times,
                                              In<double, 1> values, In<std::int64_t, 1> kinds,
                                              In<double, 2> ins, In<double, 2> outs,
                                              In<double, 2> at,
                                              std::optional<Filled<double, 2>> out) {
  const std::size_t count = times.shape(0), rows = at.shape(0), frames = at.shape(1);
  check::shape("first", first, {check::ANY});
  check::shape("times", times, {check::ANY});
  check::starts("first", first, count);
  const std::size_t curves = first.shape(0) - 1;
  check::shape("values", values, {count});
  check::shape("kinds", kinds, {count});
  check::shape("ins", ins, {count, 2});
  check::shape("outs", outs, {count, 2});
  check::shape("at", at, {rows == 1 ? 1 : curves, check::ANY});
  if (out) check::shape("out", *out, {curves, frames});
  const Keys all{times.data(), values.data(), kinds.data(), ins.data(), outs.data(), count};
  const auto keys_of = [&](std::size_t c) {
    return all.part(static_cast<std::size_t>(first.data()[c]),
                    static_cast<std::size_t>(first.data()[c + 1]));
  };
  const auto at_of = [&](std::size_t c) { return at.data() + (rows == 1 ? 0 : c * frames); };
  for (std::size_t c = 0; c < curves; ++c)
    if (!keys_of(c).count) refuse("first", c, "it has no key");
  std::optional<Out<double, 2>> made;
  if (!out) made.emplace(curves, frames);
  double* const result = out ? out->data() : made->get();
  for (std::size_t c = 0, next; c < curves; c = next) {
    const Keys keys = keys_of(c);
    bool linear[TOGETHER];
    linear[0] = check_curve(keys, c, false);
    for (next = c + 1; next < curves && next < c + TOGETHER; ++next) {
      const Keys other = keys_of(next);
      if (other.count != keys.count || !equal(other.times, keys.times, keys.count) ||
          !equal(at_of(next), at_of(c), frames))
        break;
      linear[next - c] = check_curve(other, next, true);
    }
    Walk walk(keys);
    for (std::size_t f = 0; f < frames; f += Walk::MOST) {
      walk.over(at_of(c) + f, std::min(Walk::MOST, frames - f));
      for (std::size_t i = c; i < next; ++i)
        evaluate_curve(keys_of(i), linear[i - c], walk, at_of(c) + f, result + i * frames + f);
    }
  }
  return made;
}

}  // namespace animtool
