// Scalar curves: segments between keys, evaluated at many times.
#include <algorithm>
#include <cmath>

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
  bool solve;   // whether u has to be solved for, or is the time itself
  Cubic time;   // of the span
  Cubic rise;   // from the value
};

// The Bezier polynomial from 0 by control values near and far to end.
Cubic bezier(double near, double far, double end) {
  return {3 * near, 3 * (far - 2 * near), end + 3 * (near - far)};
}

// A handle longer than the segment is shrunk to it, its slope kept; the length as
// a share of the segment.
struct Handle {
  Handle(const double* offset, double span) : length_ratio(std::fabs(offset[0]) / span), dv(offset[1]) {
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

void evaluate_half(const Half& half, const double* at, double* out, std::size_t n) {
  double x[kChunk], u[kChunk];
  for (; n; at += kChunk, out += kChunk) {
    const std::size_t count = std::min(n, kChunk);
    for (std::size_t i = 0; i < count; ++i) x[i] = (at[i] - half.key) / half.span;
    const double* cursor = x;
    if (half.solve) {
      solve_quickly(half.time, x, u, count);
      for (std::size_t i = 0; i < count; ++i)
        if (!(u[i] >= 0)) u[i] = solve_guarded(half.time, x[i]);
      cursor = u;
    }
    for (std::size_t i = 0; i < count; ++i) out[i] = half.value + half.rise.at(cursor[i]);
    n -= count;
    if (!n) return;
  }
}

// The number of leading times in [low, high).
std::size_t run_length(const double* at, std::size_t n, double low, double high) {
  std::size_t i = 0;
  while (i < n && at[i] >= low && at[i] < high) ++i;
  return i;
}

// Times in a straight segment that are worked out one by one.
constexpr std::size_t FEW = 16;

struct Keys {
  const double *times, *values;
  const std::int64_t* kinds;
  const double *ins, *outs;
};

// One curve, keys [begin, end): held outside them. Runs of times within one half
// of a segment are evaluated together.
void evaluate_curve(const Keys& keys, std::size_t begin, std::size_t end, const double* at,
                    double* out, std::size_t n) {
  const double* const times = keys.times;
  const double start = times[begin], stop = times[end - 1];
  std::size_t k = begin;
  for (std::size_t f = 0; f < n;) {
    const double t = at[f];
    if (!(t >= start && t < stop)) {
      out[f++] = t < start ? keys.values[begin] : keys.values[end - 1];
      continue;
    }
    // Times mostly ascend: then it is this segment or the next.
    if (!(t >= times[k] && t < times[k + 1])) {
      if (k + 2 < end && t >= times[k + 1] && t < times[k + 2])
        ++k;
      else
        k = static_cast<std::size_t>(std::upper_bound(times + begin, times + end, t) - times) - 1;
    }
    // Few times in a segment that is straight: it is not worth looking at as a whole.
    if (keys.kinds[k] <= kLinear && (f + FEW >= n || at[f + FEW] >= times[k + 1])) {
      const double from = times[k], to = times[k + 1], span = to - from;
      const double first = keys.values[k], middle = from + 0.5 * span;
      const bool is_hold = keys.kinds[k] == kHold;
      const double last = is_hold ? first : keys.values[k + 1], rise = last - first;
      for (; f < n && at[f] >= from && at[f] < to; ++f)
        out[f] = at[f] >= middle ? last + (at[f] - to) / -span * -rise
                                 : first + (at[f] - from) / span * rise;
      continue;
    }
    const Segment segment = make_segment(times + k, keys.values + k, keys.kinds[k],
                                         keys.outs + 2 * k, keys.ins + 2 * (k + 1));
    while (f < n) {
      const bool late = at[f] >= segment.middle;
      const double low = late ? segment.middle : segment.start;
      const double high = late ? segment.end : segment.middle;
      const std::size_t run = run_length(at + f, n - f, low, high);
      if (!run) break;
      evaluate_half(segment.halves[late], at + f, out + f, run);
      f += run;
    }
  }
}

// What would keep the search for a segment from its end: times out of order, or a segment
// whose middle is no number. The last key of a curve begins no segment.
void check_keys(const Keys& keys, const std::int64_t* first, std::size_t curves,
                std::size_t count) {
  for (std::size_t c = 0; c < curves; ++c)
    if (first[c] == first[c + 1])
      check::refuse("first", "curve " + check::text(c) + " has no key");
  std::uint64_t bits = 0;
  for (std::size_t k = 0; k < count; ++k) bits |= static_cast<std::uint64_t>(keys.kinds[k]);
  if (bits > kBezier) check::indices("kinds", keys.kinds, count, kHold, kBezier + 1);
  for (std::size_t c = 0; c < curves; ++c) {
    const std::int64_t begin = first[c], end = first[c + 1];
    const double* times = keys.times + begin;
    check::ascending("times", times, static_cast<std::size_t>(end - begin));
    // Those between are finite if the ends are, and no segment is longer than the curve.
    check::finite("times", times[end - begin - 1] - times[0]);
  }
  if (bits < kBezier) return;
  for (std::size_t k = 0; k + 1 < count; ++k) {
    if (keys.kinds[k] != kBezier) continue;
    if (std::isnan(keys.outs[2 * k])) check::refuse("outs", "a time is not a number");
    if (std::isnan(keys.ins[2 * (k + 1)])) check::refuse("ins", "a time is not a number");
  }
}

}  // namespace

Out<double, 2> evaluate_curves(In<std::int64_t, 1> first, In<double, 1> times,
                               In<double, 1> values, In<std::int64_t, 1> kinds,
                               In<double, 2> ins, In<double, 2> outs, In<double, 2> at) {
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
  const Keys keys{times.data(), values.data(), kinds.data(), ins.data(), outs.data()};
  check_keys(keys, first.data(), curves, count);
  Out<double, 2> result(curves, frames);
  for (std::size_t c = 0; c < curves; ++c)
    evaluate_curve(keys, static_cast<std::size_t>(first.data()[c]),
                   static_cast<std::size_t>(first.data()[c + 1]),
                   at.data() + (rows == 1 ? 0 : c * frames), result.get() + c * frames, frames);
  return result;
}

}  // namespace animtool
