// Rotations between keys: arcs, squad and C1 splines, for many curves with keys at the same times.
//
// Quaternions are on the double cover, where q and -q differ. The constants of a segment are
// computed once, and reused while times are in it.
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

// Half angle [rad] below which an arc is straight in double precision.
constexpr double SMALL_HALF_ANGLE = 1e-5;
// Largest rotation by the velocity at a key over either segment [rad].
constexpr double MAX_KEY_ROTATION = 6.283185307179586476925;

double dot4(const double* a, const double* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
}

// The rotation vector whose exponential is q including its sign; its length is at most two
// revolutions.
void logarithm_of_cover(const double* q, double* v) {
  const double sine = length(q), w = q[3];
  double factor;
  if (sine < SMALL_HALF_ANGLE && w > 0) {
    const double fraction = sine / w;
    factor = 2 / w * (1 - fraction * fraction / 3);
  } else {
    factor = sine > 0 ? 2 * std::atan2(sine, w) / sine : 0;
  }
  for (int i = 0; i < 3; ++i) v[i] = factor * q[i];
}

// The rotation vector from a to b in body space.
void rotation_between(const double* a, const double* b, double* v) {
  const double inverse[4] = {-a[0], -a[1], -a[2], a[3]};
  double q[4];
  product(inverse, b, q);
  logarithm_of_cover(q, v);
}

// Computes q exp(fraction v).
void rotate_by_fraction(const double* q, double fraction, const double* v, double* out) {
  const double scaled_vector[3] = {fraction * v[0], fraction * v[1], fraction * v[2]};
  double rotation[4];
  exponential(scaled_vector, rotation);
  product(q, rotation, out);
}

// The shortest arc. Half of its angle is computed from the chords, which are accurate where the
// product of the ends is not (W. Kahan, How futile are mindless assessments of roundoff, 2006).
struct Arc {
  double start[4], end[4], half_angle, sine;
  bool is_straight;

  void compute(const double* a, const double* b) {
    const double sign = dot4(a, b) < 0 ? -1 : 1;
    double squared_difference = 0, squared_sum = 0;
    for (int i = 0; i < 4; ++i) {
      start[i] = a[i], end[i] = sign * b[i];
      squared_difference += (a[i] - end[i]) * (a[i] - end[i]);
      squared_sum += (a[i] + end[i]) * (a[i] + end[i]);
    }
    half_angle = 2 * std::atan2(std::sqrt(squared_difference), std::sqrt(squared_sum));
    is_straight = half_angle < SMALL_HALF_ANGLE;
    sine = std::sin(half_angle);
  }

  void evaluate(double u, double* q) const {
    double start_weight = 1 - u, end_weight = u;
    if (!is_straight) {
      start_weight = std::sin((1 - u) * half_angle) / sine;
      end_weight = std::sin(u * half_angle) / sine;
    }
    for (int i = 0; i < 4; ++i) q[i] = start_weight * start[i] + end_weight * end[i];
    const double norm = std::sqrt(dot4(q, q));
    if (norm == 0)
      q[3] = 1;
    else
      for (int i = 0; i < 4; ++i) q[i] /= norm;
  }
};

// A rotation about a fixed axis.
struct RotationArc {
  double axis[3], half_angle;

  void compute(const double* v) {
    const double angle = length(v);
    half_angle = angle / 2;
    for (int i = 0; i < 3; ++i) axis[i] = angle > 0 ? v[i] / angle : 0;
  }

  // Computes the rotation from a to b in body space.
  void compute_between(const double* a, const double* b) {
    const double inverse[4] = {-a[0], -a[1], -a[2], a[3]};
    double q[4];
    product(inverse, b, q);
    const double sine = length(q);
    half_angle = sine > 0 ? std::atan2(sine, q[3]) : 0;
    for (int i = 0; i < 3; ++i) axis[i] = sine > 0 ? q[i] / sine : 0;
  }

  // Computes q times a fraction of the rotation.
  void apply(const double* q, double fraction, double* out) const {
    const double sine = std::sin(fraction * half_angle);
    const double rotation[4] = {sine * axis[0], sine * axis[1], sine * axis[2],
                                std::cos(fraction * half_angle)};
    product(q, rotation, out);
  }
};

// A squad segment, whose inner points follow from the velocities at its ends.
struct Squad {
  double start[4], outer_point[4];
  RotationArc outer_arc, inner_arc;

  // `step` is the rotation vector from a to b.
  void compute(const double* a, const double* b, const double* step, const double* leaving,
               const double* arriving) {
    double to_outer[3], to_inner[3], inner_point[4];
    for (int i = 0; i < 3; ++i)
      to_outer[i] = leaving[i] - step[i], to_inner[i] = step[i] - arriving[i];
    std::copy(a, a + 4, start);
    rotate_by_fraction(a, 0.5, to_outer, outer_point);
    rotate_by_fraction(b, 0.5, to_inner, inner_point);
    outer_arc.compute(step);
    inner_arc.compute_between(outer_point, inner_point);
  }

  void evaluate(double u, double* q) const {
    double outer_blend[4], inner_blend[4];
    outer_arc.apply(start, u, outer_blend);
    inner_arc.apply(outer_point, u, inner_blend);
    RotationArc blend;
    blend.compute_between(outer_blend, inner_blend);
    blend.apply(outer_blend, 2 * u * (1 - u), q);
    normalize(q);
  }
};

// A cubic segment with given velocities at its ends, in the cumulative Bezier form (M.-J. Kim,
// M.-S. Kim, S. Y. Shin, SIGGRAPH 1995).
struct Spline {
  double start[4];
  RotationArc arcs[3];

  void compute(const double* a, const double* b, const double* leaving, const double* arriving) {
    double first_step[3], last_step[3], inverse_last[3], first_point[4], last_point[4];
    for (int i = 0; i < 3; ++i)
      first_step[i] = leaving[i] / 3, last_step[i] = arriving[i] / 3,
      inverse_last[i] = -last_step[i];
    std::copy(a, a + 4, start);
    rotate_by_fraction(a, 1, first_step, first_point);
    rotate_by_fraction(b, 1, inverse_last, last_point);
    arcs[0].compute(first_step);
    arcs[1].compute_between(first_point, last_point);
    arcs[2].compute(last_step);
  }

  void evaluate(double u, double* q) const {
    const double remaining = 1 - u;
    double first[4], second[4];
    arcs[0].apply(start, 1 - remaining * remaining * remaining, first);
    arcs[1].apply(first, u * u * (3 - 2 * u), second);
    arcs[2].apply(second, u * u * u, q);
    normalize(q);
  }
};

struct RotationKeys {
  const double* times;
  std::vector<double> keys;  // (K, C, 4), normalised, with signs of the shortest path
  const std::int64_t* kinds;
  std::size_t count, curve_count;

  const double* key(std::size_t k, std::size_t c) const { return &keys[4 * (k * curve_count + c)]; }
};

// Angular velocities at keys, in body space. The velocity at a key is that of the quadratic through
// it and its neighbours. A slerp next to it takes precedence; a step has no velocity. The rows of
// the last keys are cached: as times ascend, each is computed once, with little memory.
class Velocities {
 public:
  explicit Velocities(const RotationKeys& keys) : keys_(keys) {
    for (std::size_t i = 0; i < CACHED_KEYS; ++i) {
      steps_[i].values.resize(3 * keys.curve_count);
      velocities_[i].values.resize(3 * keys.curve_count);
    }
  }

  // The rotation vectors from a key to the next one (C, 3).
  const double* steps(std::size_t k) {
    Row& row = steps_[k % CACHED_KEYS];
    if (row.key == k) return row.values.data();
    row.key = k;
    for (std::size_t c = 0; c < keys_.curve_count; ++c)
      rotation_between(keys_.key(k, c), keys_.key(k + 1, c), &row.values[3 * c]);
    return row.values.data();
  }

  // The velocities at a key (C, 3).
  const double* velocities_at(std::size_t k) {
    Row& row = velocities_[k % CACHED_KEYS];
    if (row.key == k) return row.values.data();
    row.key = k;
    compute(k, row.values);
    return row.values.data();
  }

 private:
  static constexpr std::size_t CACHED_KEYS = 4, NO_KEY = static_cast<std::size_t>(-1);

  struct Row {
    std::size_t key = NO_KEY;
    std::vector<double> values;
  };

  // Precedence of the kind of a segment in the velocity at a key.
  static int precedence(std::int64_t kind) { return kind == kStep ? 0 : kind == kSlerp ? 2 : 1; }

  void compute(std::size_t k, std::vector<double>& values) {
    const std::size_t last = keys_.count - 1;
    const double time_before = k > 0 ? keys_.times[k] - keys_.times[k - 1] : 0;
    const double time_after = k < last ? keys_.times[k + 1] - keys_.times[k] : 0;
    const int precedence_before = k > 0 ? precedence(keys_.kinds[k - 1]) : 0;
    const int precedence_after = k < last ? precedence(keys_.kinds[k]) : 0;
    std::fill(values.begin(), values.end(), 0.0);
    if (!precedence_before && !precedence_after) return;
    const double fraction = precedence_before > precedence_after ? 1
                            : precedence_before < precedence_after
                                ? 0
                                : time_after / (time_before + time_after);
    const double* arriving = precedence_before >= precedence_after ? steps(k - 1) : nullptr;
    const double* leaving = precedence_after >= precedence_before ? steps(k) : nullptr;
    for (std::size_t c = 0; c < keys_.curve_count; ++c) {
      double* out = &values[3 * c];
      for (int i = 0; i < 3; ++i) {
        if (arriving) out[i] += fraction * (arriving[3 * c + i] / time_before);
        if (leaving) out[i] += (1 - fraction) * (leaving[3 * c + i] / time_after);
      }
      const double rotation = length(out) * std::max(time_before, time_after);
      if (rotation > MAX_KEY_ROTATION)
        for (int i = 0; i < 3; ++i) out[i] *= MAX_KEY_ROTATION / rotation;
    }
  }

  const RotationKeys& keys_;
  Row steps_[CACHED_KEYS], velocities_[CACHED_KEYS];
};

// The constants of a segment of all curves, for its kind.
class Segments {
 public:
  // `velocities` may be null if no segment needs them.
  Segments(const RotationKeys& keys, Velocities* velocities)
      : keys_(keys), velocities_(velocities) {}

  // Computes the segment between the keys k and k + 1.
  void compute(std::size_t k) {
    kind_ = keys_.kinds[k];
    const std::size_t curve_count = keys_.curve_count;
    if (kind_ == kSlerp) {
      arcs_.resize(curve_count);
      for (std::size_t c = 0; c < curve_count; ++c)
        arcs_[c].compute(keys_.key(k, c), keys_.key(k + 1, c));
    } else if (kind_ != kStep) {
      const double span = keys_.times[k + 1] - keys_.times[k];
      const double *start_velocities = velocities_->velocities_at(k),
                   *end_velocities = velocities_->velocities_at(k + 1);
      const double* steps = velocities_->steps(k);
      squads_.resize(curve_count), splines_.resize(curve_count);
      for (std::size_t c = 0; c < curve_count; ++c) {
        double leaving[3], arriving[3];
        for (int i = 0; i < 3; ++i)
          leaving[i] = span * start_velocities[3 * c + i],
          arriving[i] = span * end_velocities[3 * c + i];
        if (kind_ == kSquad)
          squads_[c].compute(keys_.key(k, c), keys_.key(k + 1, c), steps + 3 * c, leaving,
                             arriving);
        else
          splines_[c].compute(keys_.key(k, c), keys_.key(k + 1, c), leaving, arriving);
      }
    }
  }

  // Computes the rotations of all curves at a fraction of the segment.
  void evaluate(std::size_t k, double u, double* out) const {
    for (std::size_t c = 0; c < keys_.curve_count; ++c, out += 4) {
      if (kind_ == kSlerp)
        arcs_[c].evaluate(u, out);
      else if (kind_ == kSquad)
        squads_[c].evaluate(u, out);
      else if (kind_ == kSpline)
        splines_[c].evaluate(u, out);
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

// Checks and normalises keys, and chooses their signs.
RotationKeys read_keys(In<double, 1> times, In<double, 3> keys, In<std::int64_t, 1> kinds) {
  const std::size_t count = times.shape(0), curve_count = keys.shape(1);
  RotationKeys result{times.data(), {}, kinds.data(), count, curve_count};
  result.keys.assign(keys.data(), keys.data() + keys.size());
  for (std::size_t k = 0; k < count; ++k)
    for (std::size_t c = 0; c < curve_count; ++c) {
      double* q = &result.keys[4 * (k * curve_count + c)];
      const auto refuse = [k](const char* message) {
        check::refuse("keys", "key " + check::text(k) + " " + message);
      };
      double sum = 0;
      for (int i = 0; i < 4; ++i) sum += q[i] * 0;
      if (!(sum == 0)) refuse("is not finite");
      if (q[0] == 0 && q[1] == 0 && q[2] == 0 && q[3] == 0) refuse("is zero: no rotation");
      ik::make_unit(q);
      if (k > 0 && dot4(q, q - 4 * curve_count) < 0)
        for (int i = 0; i < 4; ++i) q[i] = -q[i];
    }
  return result;
}

// Extrapolation of frames outside of the keys: continues with the velocity at the end, or starts a
// cycle where the previous one ended.
class Extrapolation {
 public:
  Extrapolation(const RotationKeys& keys, Velocities& velocities) : curve_count_(keys.curve_count) {
    const std::size_t last = keys.count - 1;
    end_velocities_.resize(6 * curve_count_), cycle_rotations_.resize(3 * curve_count_);
    for (std::size_t c = 0; c < curve_count_; ++c) {
      std::copy_n(velocities.velocities_at(0) + 3 * c, 3, &end_velocities_[6 * c]);
      std::copy_n(velocities.velocities_at(last) + 3 * c, 3, &end_velocities_[6 * c + 3]);
      const double* first = keys.key(0, c);
      const double inverse[4] = {-first[0], -first[1], -first[2], first[3]};
      double cycle[4];
      product(keys.key(last, c), inverse, cycle);
      if (cycle[3] < 0)
        for (int i = 0; i < 4; ++i) cycle[i] = -cycle[i];
      logarithm_of_cover(cycle, &cycle_rotations_[3 * c]);
    }
  }

  // Rotates a frame by its time beyond the keys, and by a number of cycles.
  void apply(double time_beyond, double cycle_count, double* q) const {
    for (std::size_t c = 0; c < curve_count_; ++c, q += 4) {
      double composed[4], rotation[4], vector[3];
      if (time_beyond != 0) {
        rotate_by_fraction(q, time_beyond, &end_velocities_[6 * c + (time_beyond < 0 ? 0 : 3)],
                           composed);
        normalize(composed);
        std::copy(composed, composed + 4, q);
      }
      if (cycle_count != 0) {
        for (int i = 0; i < 3; ++i) vector[i] = cycle_count * cycle_rotations_[3 * c + i];
        exponential(vector, rotation);
        product(rotation, q, composed);
        normalize(composed);
        std::copy(composed, composed + 4, q);
      }
    }
  }

 private:
  const std::size_t curve_count_;
  std::vector<double> end_velocities_, cycle_rotations_;
};

}  // namespace

Out<double, 3> evaluate_rotations(In<double, 1> times, In<double, 3> keys,
                                  In<std::int64_t, 1> kinds, In<double, 1> at,
                                  In<double, 1> times_beyond, In<double, 1> cycle_counts) {
  const std::size_t count = times.shape(0), curve_count = keys.shape(1), frames = at.shape(0);
  check::shape("keys", keys, {count, check::ANY, 4});
  check::shape("kinds", kinds, {count});
  check::shape("times_beyond", times_beyond, {frames});
  check::shape("cycle_counts", cycle_counts, {frames});
  if (count == 0) check::refuse("times", "there is no key");
  check::ascending("times", times.data(), count);
  check::finite("times", times);
  check::finite("at", at);
  check::finite("times_beyond", times_beyond);
  check::finite("cycle_counts", cycle_counts);
  check::indices("kinds", kinds, kStep, kSpline + 1);
  const RotationKeys rotation_keys = read_keys(times, keys, kinds);
  const auto has_nonzero = [](const In<double, 1>& values) {
    return std::any_of(values.data(), values.data() + values.size(),
                       [](double v) { return v != 0; });
  };
  const bool has_extrapolation = has_nonzero(times_beyond) || has_nonzero(cycle_counts);
  const bool needs_velocities = std::any_of(kinds.data(), kinds.data() + count,
                                            [](std::int64_t kind) { return kind >= kSquad; });
  std::optional<Velocities> velocities;
  if (needs_velocities || has_extrapolation) velocities.emplace(rotation_keys);
  std::optional<Extrapolation> extrapolation;
  if (has_extrapolation) extrapolation.emplace(rotation_keys, *velocities);
  Segments segments(rotation_keys, velocities ? &*velocities : nullptr);
  Out<double, 3> out(frames, curve_count, 4);
  std::vector<double> signs(curve_count, 1.0);
  std::size_t computed_segment = count, k = 0;
  for (std::size_t f = 0; f < frames; ++f) {
    double* q = out.get() + 4 * f * curve_count;
    const double t =
        std::clamp(at.data()[f], rotation_keys.times[0], rotation_keys.times[count - 1]);
    // Times mostly ascend: then it is this segment or the next.
    if (!(t >= rotation_keys.times[k] && (k + 1 == count || t < rotation_keys.times[k + 1]))) {
      if (k + 1 < count && t >= rotation_keys.times[k + 1] &&
          (k + 2 == count || t < rotation_keys.times[k + 2]))
        ++k;
      else
        k = static_cast<std::size_t>(
                std::upper_bound(rotation_keys.times, rotation_keys.times + count, t) -
                rotation_keys.times) -
            1;
    }
    if (t == rotation_keys.times[k]) {
      std::copy_n(rotation_keys.key(k, 0), 4 * curve_count, q);
    } else {
      if (computed_segment != k) segments.compute(computed_segment = k);
      segments.evaluate(
          k, (t - rotation_keys.times[k]) / (rotation_keys.times[k + 1] - rotation_keys.times[k]),
          q);
    }
    if (has_extrapolation) extrapolation->apply(times_beyond.data()[f], cycle_counts.data()[f], q);
    if (f == 0) continue;
    const double* previous = q - 4 * curve_count;
    for (std::size_t c = 0; c < curve_count; ++c) {
      if (signs[c] * dot4(q + 4 * c, previous + 4 * c) < 0) signs[c] = -signs[c];
      if (signs[c] < 0)
        for (int i = 0; i < 4; ++i) q[4 * c + i] = -q[4 * c + i];
    }
  }
  return out;
}

Out<double, 3> rotation_steps(In<double, 3> rotations) {
  const std::size_t frames = rotations.shape(0), curve_count = rotations.shape(1);
  check::shape("rotations", rotations, {check::ANY, check::ANY, 4});
  const std::size_t steps = frames ? frames - 1 : 0;
  Out<double, 3> out(steps, curve_count, 3);
  for (std::size_t i = 0; i < steps * curve_count; ++i) {
    const double* rotation = rotations.data() + 4 * i;
    const double inverse[4] = {-rotation[0], -rotation[1], -rotation[2], rotation[3]};
    double step[4];
    product(inverse, rotation + 4 * curve_count, step);
    if (step[3] < 0)
      for (double& component : step) component = -component;
    logarithm_of_cover(step, out.get() + 3 * i);
  }
  return out;
}

Out<double, 2> slerp(In<double, 2> starts, In<double, 2> ends, In<double, 1> fractions) {
  const std::size_t rows = fractions.shape(0);
  const std::size_t start_stride = starts.shape(0) == 1 ? 0 : 4,
                    end_stride = ends.shape(0) == 1 ? 0 : 4;
  check::shape("starts", starts, {start_stride ? rows : 1, 4});
  check::shape("ends", ends, {end_stride ? rows : 1, 4});
  Out<double, 2> out(rows, 4);
  Arc arc;
  for (std::size_t i = 0; i < rows; ++i) {
    arc.compute(starts.data() + start_stride * i, ends.data() + end_stride * i);
    arc.evaluate(fractions.data()[i], out.get() + 4 * i);
  }
  return out;
}

}  // namespace animtool
