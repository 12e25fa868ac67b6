// Rotations between keys: arcs, squad and C1 splines, many curves with keys at one time.
//
// Quaternions are on the double cover, where q and -q differ. What a segment is made of is
// worked out once and stays while times are within it.
#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "base/checks.h"
#include "base/quaternions.h"
#include "curves/curves.h"

namespace animtool {

namespace {

using ik::exponential;
using ik::length;
using ik::normalize;
using ik::product;

enum RotationKind : std::int64_t { kStep = 0, kSlerp = 1, kSquad = 2, kSpline = 3 };

// Below this half of an angle [rad] an arc is straight to the last digit.
constexpr double SMALL_HALF = 1e-5;
// A velocity at a key turns by no more than this over either segment [rad].
constexpr double MAX_ROTATION = 6.283185307179586476925;

double dot4(const double* a, const double* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
}

// The rotation vector whose exponential is q, sign and all; its length is at most two turns.
void logarithm_of_cover(const double* q, double* v) {
  const double sine = length(q), w = q[3];
  double factor;
  if (sine < SMALL_HALF && w > 0) {
    const double fraction = sine / w;
    factor = 2 / w * (1 - fraction * fraction / 3);
  } else {
    factor = sine > 0 ? 2 * std::atan2(sine, w) / sine : 0;
  }
  for (int i = 0; i < 3; ++i) v[i] = factor * q[i];
}

// From a to b in body space.
void rotation_between(const double* a, const double* b, double* v) {
  const double back[4] = {-a[0], -a[1], -a[2], a[3]};
  double q[4];
  product(back, b, q);
  logarithm_of_cover(q, v);
}

// q exp(share v)
void rotate_further(const double* q, double fraction, const double* v, double* out) {
  const double scaled[3] = {fraction * v[0], fraction * v[1], fraction * v[2]};
  double by[4];
  exponential(scaled, by);
  product(q, by, out);
}

// The shortest arc: half of its angle by the chords, which keep their digits where the product
// of the ends does not (W. Kahan, How futile are mindless assessments of roundoff, 2006).
struct Arc {
  double start[4], end[4], half, sine;
  bool straight;

  void set(const double* a, const double* b) {
    const double sign = dot4(a, b) < 0 ? -1 : 1;
    double distance = 0, opposed = 0;
    for (int i = 0; i < 4; ++i) {
      start[i] = a[i], end[i] = sign * b[i];
      distance += (a[i] - end[i]) * (a[i] - end[i]);
      opposed += (a[i] + end[i]) * (a[i] + end[i]);
    }
    half = 2 * std::atan2(std::sqrt(distance), std::sqrt(opposed));
    straight = half < SMALL_HALF;
    sine = std::sin(half);
  }

  void at(double u, double* q) const {
    double first = 1 - u, second = u;
    if (!straight) {
      first = std::sin((1 - u) * half) / sine;
      second = std::sin(u * half) / sine;
    }
    for (int i = 0; i < 4; ++i) q[i] = first * start[i] + second * end[i];
    const double size = std::sqrt(dot4(q, q));
    if (size == 0)
      q[3] = 1;
    else
      for (int i = 0; i < 4; ++i) q[i] /= size;
  }
};

// A turn about an axis of its own.
struct RotationArc {
  double axis[3], half;

  void set(const double* v) {
    const double angle = length(v);
    half = angle / 2;
    for (int i = 0; i < 3; ++i) axis[i] = angle > 0 ? v[i] / angle : 0;
  }

  // From a to b in body space.
  void set_between(const double* a, const double* b) {
    const double back[4] = {-a[0], -a[1], -a[2], a[3]};
    double q[4];
    product(back, b, q);
    const double sine = length(q);
    half = sine > 0 ? std::atan2(sine, q[3]) : 0;
    for (int i = 0; i < 3; ++i) axis[i] = sine > 0 ? q[i] / sine : 0;
  }

  // q times a share of it.
  void on(const double* q, double fraction, double* out) const {
    const double sine = std::sin(fraction * half);
    const double by[4] = {sine * axis[0], sine * axis[1], sine * axis[2],
                          std::cos(fraction * half)};
    product(q, by, out);
  }
};

// Segments whose inner points follow from the velocities at their ends.
struct Squad {
  double start[4], outer[4];
  RotationArc along, across;

  // `step` is the rotation vector from a to b.
  void set(const double* a, const double* b, const double* step, const double* leaving,
           const double* arriving) {
    double to_outer[3], to_inner[3], inner[4];
    for (int i = 0; i < 3; ++i)
      to_outer[i] = leaving[i] - step[i], to_inner[i] = step[i] - arriving[i];
    std::copy(a, a + 4, start);
    rotate_further(a, 0.5, to_outer, outer);
    rotate_further(b, 0.5, to_inner, inner);
    along.set(step);
    across.set_between(outer, inner);
  }

  void at(double u, double* q) const {
    double near[4], far[4];
    along.on(start, u, near);
    across.on(outer, u, far);
    RotationArc between;
    between.set_between(near, far);
    between.on(near, 2 * u * (1 - u), q);
    normalize(q);
  }
};

// Cubic segments by the velocities at their ends, in the cumulative Bezier form (M.-J. Kim,
// M.-S. Kim, S. Y. Shin, SIGGRAPH 1995).
struct Spline {
  double start[4];
  RotationArc arcs[3];

  void set(const double* a, const double* b, const double* leaving, const double* arriving) {
    double first[3], last[3], back[3], near[4], far[4];
    for (int i = 0; i < 3; ++i)
      first[i] = leaving[i] / 3, last[i] = arriving[i] / 3, back[i] = -last[i];
    std::copy(a, a + 4, start);
    rotate_further(a, 1, first, near);
    rotate_further(b, 1, back, far);
    arcs[0].set(first);
    arcs[1].set_between(near, far);
    arcs[2].set(last);
  }

  void at(double u, double* q) const {
    const double left = 1 - u;
    double one[4], two[4];
    arcs[0].on(start, 1 - left * left * left, one);
    arcs[1].on(one, u * u * (3 - 2 * u), two);
    arcs[2].on(two, u * u * u, q);
    normalize(q);
  }
};

struct RotationKeys {
  const double* times;
  std::vector<double> keys;  // (K, C, 4), at length 1, signs along the short way
  const std::int64_t* kinds;
  std::size_t count, curves;

  const double* key(std::size_t k, std::size_t c) const { return &keys[4 * (k * curves + c)]; }
};

// Angular velocities in body space. Each key's is that of the quadratic through it and its
// neighbours; a slerp beside it has its say, a step has none. Those of the last keys asked for
// are kept: as times ascend, each is worked out once, in little memory.
class Velocities {
 public:
  explicit Velocities(const RotationKeys& keys) : keys_(keys) {
    for (std::size_t i = 0; i < KEPT; ++i) {
      steps_[i].values.resize(3 * keys.curves);
      velocities_[i].values.resize(3 * keys.curves);
    }
  }

  // The rotation vectors from a key to the next (C, 3).
  const double* steps(std::size_t k) {
    Row& row = steps_[k % KEPT];
    if (row.key == k) return row.values.data();
    row.key = k;
    for (std::size_t c = 0; c < keys_.curves; ++c)
      rotation_between(keys_.key(k, c), keys_.key(k + 1, c), &row.values[3 * c]);
    return row.values.data();
  }

  // The velocities at a key (C, 3).
  const double* at(std::size_t k) {
    Row& row = velocities_[k % KEPT];
    if (row.key == k) return row.values.data();
    row.key = k;
    set(k, row.values);
    return row.values.data();
  }

 private:
  static constexpr std::size_t KEPT = 4, NONE = static_cast<std::size_t>(-1);

  struct Row {
    std::size_t key = NONE;
    std::vector<double> values;
  };

  static int rank(std::int64_t kind) { return kind == kStep ? 0 : kind == kSlerp ? 2 : 1; }

  void set(std::size_t k, std::vector<double>& values) {
    const std::size_t last = keys_.count - 1;
    const double before = k > 0 ? keys_.times[k] - keys_.times[k - 1] : 0;
    const double after = k < last ? keys_.times[k + 1] - keys_.times[k] : 0;
    const int first = k > 0 ? rank(keys_.kinds[k - 1]) : 0;
    const int second = k < last ? rank(keys_.kinds[k]) : 0;
    std::fill(values.begin(), values.end(), 0.0);
    if (!first && !second) return;
    const double fraction = first > second ? 1 : first < second ? 0 : after / (before + after);
    const double* arriving = first >= second ? steps(k - 1) : nullptr;
    const double* leaving = second >= first ? steps(k) : nullptr;
    for (std::size_t c = 0; c < keys_.curves; ++c) {
      double* out = &values[3 * c];
      for (int i = 0; i < 3; ++i) {
        if (arriving) out[i] += fraction * (arriving[3 * c + i] / before);
        if (leaving) out[i] += (1 - fraction) * (leaving[3 * c + i] / after);
      }
      const double limit = length(out) * std::max(before, after);
      if (limit > MAX_ROTATION)
        for (int i = 0; i < 3; ++i) out[i] *= MAX_ROTATION / limit;
    }
  }

  const RotationKeys& keys_;
  Row steps_[KEPT], velocities_[KEPT];
};

// What a segment of every curve is made of, for the kind that it has.
class Segments {
 public:
  // Without velocities where no segment asks for any.
  Segments(const RotationKeys& keys, Velocities* velocities)
      : keys_(keys), velocities_(velocities) {}

  // Of the keys k and k + 1.
  void set(std::size_t k) {
    kind_ = keys_.kinds[k];
    const std::size_t curves = keys_.curves;
    if (kind_ == kSlerp) {
      arcs_.resize(curves);
      for (std::size_t c = 0; c < curves; ++c) arcs_[c].set(keys_.key(k, c), keys_.key(k + 1, c));
    } else if (kind_ != kStep) {
      const double span = keys_.times[k + 1] - keys_.times[k];
      const double *starts = velocities_->at(k), *ends = velocities_->at(k + 1);
      const double* steps = velocities_->steps(k);
      squads_.resize(curves), splines_.resize(curves);
      for (std::size_t c = 0; c < curves; ++c) {
        double leaving[3], arriving[3];
        for (int i = 0; i < 3; ++i)
          leaving[i] = span * starts[3 * c + i], arriving[i] = span * ends[3 * c + i];
        if (kind_ == kSquad)
          squads_[c].set(keys_.key(k, c), keys_.key(k + 1, c), steps + 3 * c, leaving, arriving);
        else
          splines_[c].set(keys_.key(k, c), keys_.key(k + 1, c), leaving, arriving);
      }
    }
  }

  void at(std::size_t k, double u, double* out) const {
    for (std::size_t c = 0; c < keys_.curves; ++c, out += 4) {
      if (kind_ == kSlerp)
        arcs_[c].at(u, out);
      else if (kind_ == kSquad)
        squads_[c].at(u, out);
      else if (kind_ == kSpline)
        splines_[c].at(u, out);
      else
        std::copy_n(keys_.key(k, c), 4, out);
    }
  }

 private:
  const RotationKeys& keys_;
  Velocities* velocities_;
  std::int64_t kind_ = kStep;
  std::vector<Arc> arcs_;
  std::vector<Squad> squads_;
  std::vector<Spline> splines_;
};

RotationKeys read_keys(In<double, 1> times, In<double, 3> keys, In<std::int64_t, 1> kinds) {
  const std::size_t count = times.shape(0), curves = keys.shape(1);
  RotationKeys read{times.data(), {}, kinds.data(), count, curves};
  read.keys.assign(keys.data(), keys.data() + keys.size());
  for (std::size_t k = 0; k < count; ++k)
    for (std::size_t c = 0; c < curves; ++c) {
      double* q = &read.keys[4 * (k * curves + c)];
      const auto refuse = [k](const char* why) {
        check::refuse("keys", "key " + check::text(k) + " " + why);
      };
      double sum = 0;
      for (int i = 0; i < 4; ++i) sum += q[i] * 0;
      if (!(sum == 0)) refuse("is not finite");
      if (q[0] == 0 && q[1] == 0 && q[2] == 0 && q[3] == 0) refuse("is zero: no rotation");
      ik::make_unit(q);
      if (k > 0 && dot4(q, q - 4 * curves) < 0)
        for (int i = 0; i < 4; ++i) q[i] = -q[i];
    }
  return read;
}

// Frames beyond the keys go on with the velocity at the end, or begin a cycle where the last
// one ended.
class Beyond {
 public:
  Beyond(const RotationKeys& keys, Velocities& velocities) : curves_(keys.curves) {
    const std::size_t last = keys.count - 1;
    ends_.resize(6 * curves_), rises_.resize(3 * curves_);
    for (std::size_t c = 0; c < curves_; ++c) {
      std::copy_n(velocities.at(0) + 3 * c, 3, &ends_[6 * c]);
      std::copy_n(velocities.at(last) + 3 * c, 3, &ends_[6 * c + 3]);
      const double* first = keys.key(0, c);
      const double back[4] = {-first[0], -first[1], -first[2], first[3]};
      double rise[4];
      product(keys.key(last, c), back, rise);
      if (rise[3] < 0)
        for (int i = 0; i < 4; ++i) rise[i] = -rise[i];
      logarithm_of_cover(rise, &rises_[3 * c]);
    }
  }

  void limit(double beyond, double cycles, double* q) const {
    for (std::size_t c = 0; c < curves_; ++c, q += 4) {
      double composed[4], by[4], turned[3];
      if (beyond != 0) {
        rotate_further(q, beyond, &ends_[6 * c + (beyond < 0 ? 0 : 3)], composed);
        normalize(composed);
        std::copy(composed, composed + 4, q);
      }
      if (cycles != 0) {
        for (int i = 0; i < 3; ++i) turned[i] = cycles * rises_[3 * c + i];
        exponential(turned, by);
        product(by, q, composed);
        normalize(composed);
        std::copy(composed, composed + 4, q);
      }
    }
  }

 private:
  const std::size_t curves_;
  std::vector<double> ends_, rises_;
};

}  // namespace

Out<double, 3> evaluate_rotations(In<double, 1> times, In<double, 3> keys,
                                  In<std::int64_t, 1> kinds, In<double, 1> at, In<double, 1> beyond,
                                  In<double, 1> cycles) {
  const std::size_t count = times.shape(0), curves = keys.shape(1), frames = at.shape(0);
  check::shape("keys", keys, {count, check::ANY, 4});
  check::shape("kinds", kinds, {count});
  check::shape("beyond", beyond, {frames});
  check::shape("cycles", cycles, {frames});
  if (count == 0) check::refuse("times", "there is no key");
  check::ascending("times", times.data(), count);
  check::finite("times", times);
  check::finite("at", at);
  check::finite("beyond", beyond);
  check::finite("cycles", cycles);
  check::indices("kinds", kinds, kStep, kSpline + 1);
  const RotationKeys read = read_keys(times, keys, kinds);
  const auto goes_on = [](const In<double, 1>& values) {
    return std::any_of(values.data(), values.data() + values.size(),
                       [](double v) { return v != 0; });
  };
  const bool outside = goes_on(beyond) || goes_on(cycles);
  const bool bends = std::any_of(kinds.data(), kinds.data() + count,
                                 [](std::int64_t kind) { return kind >= kSquad; });
  std::optional<Velocities> velocities;
  if (bends || outside) velocities.emplace(read);
  std::optional<Beyond> ends;
  if (outside) ends.emplace(read, *velocities);
  Segments segments(read, velocities ? &*velocities : nullptr);
  Out<double, 3> out(frames, curves, 4);
  std::vector<double> flips(curves, 1.0);
  std::size_t set = count, k = 0;
  for (std::size_t f = 0; f < frames; ++f) {
    double* q = out.get() + 4 * f * curves;
    const double t = std::clamp(at.data()[f], read.times[0], read.times[count - 1]);
    // Times mostly ascend: then it is this segment or the next.
    if (!(t >= read.times[k] && (k + 1 == count || t < read.times[k + 1]))) {
      if (k + 1 < count && t >= read.times[k + 1] && (k + 2 == count || t < read.times[k + 2]))
        ++k;
      else
        k = static_cast<std::size_t>(std::upper_bound(read.times, read.times + count, t) -
                                     read.times) -
            1;
    }
    if (t == read.times[k]) {
      std::copy_n(read.key(k, 0), 4 * curves, q);
    } else {
      if (set != k) segments.set(set = k);
      segments.at(k, (t - read.times[k]) / (read.times[k + 1] - read.times[k]), q);
    }
    if (outside) ends->limit(beyond.data()[f], cycles.data()[f], q);
    if (f == 0) continue;
    const double* last = q - 4 * curves;
    for (std::size_t c = 0; c < curves; ++c) {
      if (flips[c] * dot4(q + 4 * c, last + 4 * c) < 0) flips[c] = -flips[c];
      if (flips[c] < 0)
        for (int i = 0; i < 4; ++i) q[4 * c + i] = -q[4 * c + i];
    }
  }
  return out;
}

Out<double, 3> rotation_steps(In<double, 3> rotations) {
  const std::size_t frames = rotations.shape(0), curves = rotations.shape(1);
  check::shape("rotations", rotations, {check::ANY, check::ANY, 4});
  const std::size_t steps = frames ? frames - 1 : 0;
  Out<double, 3> out(steps, curves, 3);
  for (std::size_t i = 0; i < steps * curves; ++i) {
    const double* one = rotations.data() + 4 * i;
    const double back[4] = {-one[0], -one[1], -one[2], one[3]};
    double step[4];
    product(back, one + 4 * curves, step);
    if (step[3] < 0)
      for (double& part : step) part = -part;
    logarithm_of_cover(step, out.get() + 3 * i);
  }
  return out;
}

Out<double, 2> slerp(In<double, 2> starts, In<double, 2> ends, In<double, 1> shares) {
  const std::size_t rows = shares.shape(0);
  const std::size_t one = starts.shape(0) == 1 ? 0 : 4, other = ends.shape(0) == 1 ? 0 : 4;
  check::shape("starts", starts, {one ? rows : 1, 4});
  check::shape("ends", ends, {other ? rows : 1, 4});
  Out<double, 2> out(rows, 4);
  Arc arc;
  for (std::size_t i = 0; i < rows; ++i) {
    arc.set(starts.data() + one * i, ends.data() + other * i);
    arc.at(shares.data()[i], out.get() + 4 * i);
  }
  return out;
}

}  // namespace animtool
