// Four strands in parallel over a frame, in small steps: compliant springs are projected one after
// the other, stiff springs along the strand are solved by a tridiagonal system.
//
// T.-H. Han, T. Harada, Tridiagonal Matrix Formulation for Inextensible Hair Strand
// Simulation, 2013; M. Macklin et al., Small Steps in Physics Simulation, 2019.
#pragma once

#include <cstddef>
#include <cstdint>

#include "colliders/wide.h"
#include "springs/rows.h"

namespace animtool {

// Queries of colliders other than capsules and spheres, for one particle and the row (step, C):
// distance and outward direction at the start or the end of a step; and a continuous test that
// stops fast particles.
struct GeneralColliders {
  const void* context;
  void (*sample)(const void* context, std::size_t row, bool is_at_end, const double* point,
                 double* distance_and_normal);
  bool (*sweep)(const void* context, std::size_t row, const double* start, double* end);
};

struct StrandBundle;

// Collides the segments of one of four strands with features finer than a segment. Returns whether
// any particle moved, and adds the displacements to their path lengths.
struct SegmentContacts {
  void* context = nullptr;  // null without such features
  bool (*resolve)(void* context, StrandBundle& bundle, std::size_t step, std::size_t lane,
                  std::size_t near_count) = nullptr;
  double search_distance =
      0;  // segments of a particle farther than this from all colliders cannot touch
};

// Constants of a frame, shared by all strands.
struct StrandSteps {
  std::size_t point_count, interval_count, substeps;
  double h;
  double gravity_step[3];  // velocity change by gravity in a step
  double drag_factor;      // factor of velocities by drag
  // Compliances: of bending springs, and of the one at the root; of the pull to the animation, by
  // position and by velocity; of springs along the strand.
  double bend_factor, root_bend_factor, goal_pull_factor, goal_damping_factor, along_compliance;
  double max_length_ratio;  // largest length of springs along the strand, over their rest length
  std::size_t collider_count;
  const collide::MovingCapsule* capsules;  // (steps, C)
  // Whether a collider is a capsule or sphere, and whether the displacement of its surface is known
  // (C,).
  const unsigned char *is_capsule, *is_bounded;
  std::size_t depth_row_count;  // number of leading colliders with allowed depths
  const double* thicknesses;    // (C,)
  // Common drift of each step (steps, 3); bounds of the surface displacement relative to it, from
  // each step to the end of the frame (steps + 1, C).
  const double *drifts, *remaining_shifts;
  GeneralColliders general_colliders;
  double inside_tolerance;
};

// Four strands of P particles; vectors are (P, 3, 4).
struct StrandBundle {
  double *x, *before, *v;
  double* reference_positions;  // positions relative to which velocities are measured; they move
                                // with slow depenetration
  const double* goals;          // (intervals + 1, P, 3, 4)
  const double *rest_lengths, *bend_lengths;
  // Allowed depths of each strand in the first collider, and the stride to the next collider.
  const double* depths[SIMD_WIDTH];
  std::size_t depth_stride;
  unsigned strand_bits;  // bits of strands that are not padding
  // Buffers: unit vectors along each spring (P, 3, 4), and the matrix (P, 3, 4).
  double *directions, *matrix;
  // Path length of each particle relative to the drift (P,); path lengths at which it may touch any
  // collider (P,), and each collider (P, C); indices of nearby colliders (C,).
  double *path_lengths, *contact_paths, *collider_paths;
  std::size_t* near_colliders;
  SegmentContacts segments;
  std::int32_t* segment_particles;  // particles with a segment near a collider (P,)
  // Results: number of particles moved by colliders in each step; number that remain inside; the
  // largest strain.
  std::int64_t* touched_counts;
  std::int64_t inside_count;
  double max_strain;
};

// Largest number of length corrections in a step; the first one covers all strands.
constexpr int MAX_CORRECTIONS = 4;
// Length corrections after collisions; each is followed by more collisions.
constexpr int MAX_CONTACT_CORRECTIONS = 5;
// Iterations over all colliders.
constexpr int MAX_COLLIDER_ITERATIONS = 3;
// Colliders farther away than this at the start of a frame are rarely touched in it [m].
constexpr double NEAR_COLLIDER_DISTANCE = 0.1;

// Advances one bundle over a frame.
template <class Simd>
class BundleSolver {
  using N = Four<Simd>;
  using V = FourVec<Simd>;

 public:
  BundleSolver(const StrandSteps& plan, StrandBundle& bundle) : plan_(plan), bundle_(bundle) {}

  void advance() {
    find_near_colliders();
    const double inverse_h = 1 / plan_.h;
    for (std::size_t interval = 0; interval < plan_.interval_count; ++interval)
      for (std::size_t substep = 0; substep < plan_.substeps; ++substep) {
        const double count = static_cast<double>(plan_.substeps);
        interval_goals_ = bundle_.goals + interval * FOUR_VEC_SIZE * plan_.point_count;
        begin_fraction_ = static_cast<double>(substep) / count;
        end_fraction_ = static_cast<double>(substep + 1) / count;
        predict_positions();
        apply_bending();
        apply_goal_pull();
        N strand_mask = less(N(0.0), N(1.0));
        for (int i = 0; i < MAX_CORRECTIONS && mask_bits(strand_mask); ++i) {
          correct_lengths<false>(strand_mask);
          strand_mask = find_overlong_strands();
        }
        resolve_collisions(interval * plan_.substeps + substep);
        for (std::size_t p = 0; p < plan_.point_count; ++p)
          ((load_vector(bundle_.x, p) - load_vector(bundle_.reference_positions, p)) * inverse_h)
              .store(bundle_.v + FOUR_VEC_SIZE * p);
      }
    bundle_.inside_count = count_inside();
    bundle_.max_strain = max_strain();
  }

 private:
  static V load_vector(const double* rows, std::size_t p) {
    return V::load(rows + FOUR_VEC_SIZE * p);
  }

  // Animated position of a particle at a fraction of the interval; exact at both ends.
  V goal_position(std::size_t p, double fraction) const {
    return load_vector(interval_goals_, p) * (1 - fraction) +
           load_vector(interval_goals_ + FOUR_VEC_SIZE * plan_.point_count, p) * fraction;
  }

  void predict_positions() {
    const V gravity_step = V::broadcast(plan_.gravity_step);
    load_vector(bundle_.x, 0).store(bundle_.before);
    load_vector(bundle_.x, 0).store(bundle_.reference_positions);
    goal_position(0, end_fraction_).store(bundle_.x);
    for (std::size_t p = 1; p < plan_.point_count; ++p) {
      const V x = load_vector(bundle_.x, p);
      x.store(bundle_.before + FOUR_VEC_SIZE * p);
      x.store(bundle_.reference_positions + FOUR_VEC_SIZE * p);
      const V v = (load_vector(bundle_.v, p) + gravity_step) * plan_.drag_factor;
      (x + v * plan_.h).store(bundle_.x + FOUR_VEC_SIZE * p);
    }
  }

  void apply_bending() {
    if (plan_.bend_factor == 0) return;
    for (std::size_t p = 0; p + 2 < plan_.point_count; ++p) {
      const V a = load_vector(bundle_.x, p), b = load_vector(bundle_.x, p + 2), d = b - a;
      const N square = dot(d, d), rest_length = N::load(bundle_.bend_lengths + SIMD_WIDTH * p);
      // Coincident ends have no direction, and no force.
      const N strain_scale = select(less(N(0.0), square), N(1.0), N(0.0));
      const N strain = strain_scale - rest_length * (sqrt(square) * inverse(square));
      const V correction = d * (strain * (p == 0 ? plan_.root_bend_factor : plan_.bend_factor));
      if (p > 0) (a + correction).store(bundle_.x + FOUR_VEC_SIZE * p);
      (b - correction).store(bundle_.x + FOUR_VEC_SIZE * (p + 2));
    }
  }

  void apply_goal_pull() {
    if (plan_.goal_pull_factor == 0) return;
    for (std::size_t p = 1; p < plan_.point_count; ++p) {
      const V x = load_vector(bundle_.x, p), offset = goal_position(p, end_fraction_) - x;
      const V offset_change =
          offset - (goal_position(p, begin_fraction_) - load_vector(bundle_.before, p));
      (x + offset * plan_.goal_pull_factor + offset_change * plan_.goal_damping_factor)
          .store(bundle_.x + FOUR_VEC_SIZE * p);
    }
  }

  // Mask of strands with a spring above its largest length: those that rotate far in a step.
  N find_overlong_strands() const {
    N is_overlong = less(N(0.0), N(0.0));
    for (std::size_t p = 1; p < plan_.point_count; ++p) {
      const V d = load_vector(bundle_.x, p) - load_vector(bundle_.x, p - 1);
      const N max_length =
          N::load(bundle_.rest_lengths + SIMD_WIDTH * (p - 1)) * plan_.max_length_ratio;
      is_overlong = mask_or(is_overlong, less(max_length * max_length, dot(d, d)));
    }
    return is_overlong;
  }

  // One Newton correction of all lengths along some of the strands. Each spring moves its
  // neighbours, so that the matrix is tridiagonal. Optionally adds the displacements to the path
  // lengths.
  template <bool RecordPath>
  void correct_lengths(const N& strand_mask) {
    V previous{0.0, 0.0, 0.0};
    N inverse_pivot(0.0), residual(0.0);
    for (std::size_t p = 1; p < plan_.point_count; ++p) {
      const V d = load_vector(bundle_.x, p) - load_vector(bundle_.x, p - 1);
      const N spring_length = length(d);
      const V direction = d * inverse(spring_length);
      // Coupling of springs that share a particle; the root does not move.
      const N coupling = dot(previous, direction);
      const N pivot =
          N((p == 1 ? 1 : 2) + plan_.along_compliance) - coupling * coupling * inverse_pivot;
      residual = spring_length - N::load(bundle_.rest_lengths + SIMD_WIDTH * (p - 1)) +
                 coupling * inverse_pivot * residual;
      inverse_pivot = N(1.0) / pivot;
      direction.store(bundle_.directions + FOUR_VEC_SIZE * p);
      double* row = bundle_.matrix + FOUR_VEC_SIZE * p;
      coupling.store(row);
      inverse_pivot.store(row + SIMD_WIDTH);
      residual.store(row + 2 * SIMD_WIDTH);
      previous = direction;
    }
    N multiplier(0.0), coupling(0.0);
    V next_shift{0.0, 0.0, 0.0};
    for (std::size_t p = plan_.point_count; p-- > 1;) {
      const double* row = bundle_.matrix + FOUR_VEC_SIZE * p;
      multiplier =
          (N::load(row + 2 * SIMD_WIDTH) + coupling * multiplier) * N::load(row + SIMD_WIDTH);
      coupling = N::load(row);
      const V spring_shift = load_vector(bundle_.directions, p) * multiplier;
      const V x = load_vector(bundle_.x, p),
              shift = select(strand_mask, next_shift - spring_shift, V{0.0, 0.0, 0.0});
      (x + shift).store(bundle_.x + FOUR_VEC_SIZE * p);
      if constexpr (RecordPath) bundle_.path_lengths[p] += largest(length(shift));
      next_shift = spring_shift;
    }
  }

  static N length(const V& a) { return sqrt(dot(a, a)); }

  // The section of the strands that a point is in: one of four, from root to tip.
  std::size_t section_of(std::size_t p) const { return p * SIMD_WIDTH / plan_.point_count; }

  // Bounding ball of each section over all strands: centre and radius. Returns bits of the sections
  // that exist: strands with few points do not have all.
  unsigned bound_sections(V& centre, N& radius) const {
    unsigned section_bits = 0;
    double low[3][SIMD_WIDTH], high[3][SIMD_WIDTH];
    for (std::size_t k = 0; k < 3; ++k)
      for (std::size_t g = 0; g < SIMD_WIDTH; ++g)
        low[k][g] = HUGE_DISTANCE, high[k][g] = -HUGE_DISTANCE;
    for (std::size_t p = 0; p < plan_.point_count; ++p) {
      const std::size_t g = section_of(p);
      section_bits |= 1u << g;
      for (std::size_t k = 0; k < 3; ++k) {
        const N row = N::load(bundle_.x + FOUR_VEC_SIZE * p + SIMD_WIDTH * k);
        const double smallest_value = smallest(row), largest_value = largest(row);
        low[k][g] = smallest_value < low[k][g] ? smallest_value : low[k][g];
        high[k][g] = largest_value > high[k][g] ? largest_value : high[k][g];
      }
    }
    const V lowest = V::load(low[0]), half_extent = (V::load(high[0]) - lowest) * 0.5;
    centre = lowest + half_extent;
    radius = length(half_extent);
    return section_bits;
  }

  // Finds the colliders near the strands, and bounds the distance of each section from them at the
  // start of the frame.
  void find_near_colliders() {
    near_count_ = 0;
    far_contact_path_ = HUGE_DISTANCE;
    if (plan_.collider_count == 0) return;
    V centre;
    N radius;
    const unsigned section_bits = bound_sections(centre, radius);
    for (std::size_t c = 0; c < plan_.collider_count; ++c) {
      double distances[SIMD_WIDTH] = {0, 0, 0, 0};
      if (plan_.is_capsule[c]) {
        const collide::MovingCapsule& capsule = plan_.capsules[c];
        const N distance =
            sample_moving_capsule(capsule.begin, capsule.radius, centre).distance - radius;
        (max(distance, N(0.0)) - plan_.remaining_shifts[c]).store(distances);
      }
      double nearest_distance = HUGE_DISTANCE;
      for (std::size_t g = 0; g < SIMD_WIDTH; ++g)
        if ((section_bits >> g & 1) && distances[g] < nearest_distance)
          nearest_distance = distances[g];
      if (nearest_distance >= NEAR_COLLIDER_DISTANCE) {
        far_contact_path_ =
            nearest_distance < far_contact_path_ ? nearest_distance : far_contact_path_;
        continue;
      }
      bundle_.near_colliders[near_count_++] = c;
      for (std::size_t p = 0; p < plan_.point_count; ++p)
        bundle_.collider_paths[p * plan_.collider_count + c] = distances[section_of(p)];
    }
    for (std::size_t p = 0; p < plan_.point_count; ++p) {
      bundle_.path_lengths[p] = 0;
      bundle_.contact_paths[p] = next_contact_path(p);
    }
  }

  // Path length at which a particle may touch any collider.
  double next_contact_path(std::size_t p) const {
    const double* paths = bundle_.collider_paths + p * plan_.collider_count;
    double next = far_contact_path_;
    for (std::size_t k = 0; k < near_count_; ++k) {
      const double path = paths[bundle_.near_colliders[k]];
      next = path < next ? path : next;
    }
    return next;
  }

  // Moves particles out of colliders, as the last stage of a step, and corrects strands that this
  // stretches.
  void resolve_collisions(std::size_t step) {
    if (plan_.collider_count == 0) return;
    const V drift = V::broadcast(plan_.drifts + 3 * step);
    for (std::size_t p = 1; p < plan_.point_count; ++p)
      bundle_.path_lengths[p] +=
          largest(length(load_vector(bundle_.x, p) - load_vector(bundle_.before, p) - drift));
    unsigned touched_count = 0;
    select_strands(ALL_STRANDS);
    unsigned moved_strands = collide_particles(step, touched_count);
    bundle_.touched_counts[step] += touched_count;
    for (int i = 0; i < MAX_CONTACT_CORRECTIONS && moved_strands; ++i) {
      moved_strands &= mask_bits(find_overlong_strands());
      if (!moved_strands) break;
      select_strands(moved_strands);
      correct_lengths<true>(selected_mask_);
      moved_strands &= collide_particles(step, touched_count);
    }
  }

  // Selects the strands that colliders may move, by their bits.
  void select_strands(unsigned strand_bits) {
    double lanes[SIMD_WIDTH];
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l) lanes[l] = strand_bits >> l & 1;
    selected_mask_ = less(N(0.0), N::load(lanes));
    selected_strand_bits_ = strand_bits;
  }

  // Moves particles out of colliders; returns the bits of strands that moved.
  unsigned collide_particles(std::size_t step, unsigned& touched_count) {
    unsigned moved_strands = 0;
    for (std::size_t p = 1; p < plan_.point_count; ++p) {
      if (bundle_.path_lengths[p] < bundle_.contact_paths[p]) continue;
      if (bundle_.path_lengths[p] >= far_contact_path_) include_all_colliders();
      const double displacement =
          largest(length(load_vector(bundle_.x, p) - load_vector(bundle_.before, p)));
      const unsigned moved_bits = resolve(step, p, displacement);
      touched_count += count_strands(moved_bits);
      moved_strands |= moved_bits;
    }
    return bundle_.segments.context ? moved_strands | collide_segments(step) : moved_strands;
  }

  // Collides the segments between particles; the root counts as near if any particle is. Returns
  // the bits of strands that moved.
  unsigned collide_segments(std::size_t step) {
    std::size_t near_count = 0;
    bundle_.segment_particles[near_count++] = 0;
    for (std::size_t p = 1; p < plan_.point_count; ++p)
      if (bundle_.path_lengths[p] + bundle_.segments.search_distance >= bundle_.contact_paths[p])
        bundle_.segment_particles[near_count++] = static_cast<std::int32_t>(p);
    unsigned moved_strands = 0;
    for (std::size_t l = 0; near_count > 1 && l < SIMD_WIDTH; ++l) {
      if (!((selected_strand_bits_ & bundle_.strand_bits) >> l & 1)) continue;
      if (bundle_.segments.resolve(bundle_.segments.context, bundle_, step, l, near_count))
        moved_strands |= 1u << l;
    }
    return moved_strands;
  }

  // Treats all colliders as near from here on.
  void include_all_colliders() {
    const std::size_t count = plan_.collider_count;
    for (std::size_t c = 0; c < count; ++c) {
      bool is_near = false;
      for (std::size_t k = 0; k < near_count_; ++k)
        is_near = is_near || bundle_.near_colliders[k] == c;
      for (std::size_t p = 0; !is_near && p < plan_.point_count; ++p)
        bundle_.collider_paths[p * count + c] = 0;
    }
    for (near_count_ = 0; near_count_ < count; ++near_count_)
      bundle_.near_colliders[near_count_] = near_count_;
    for (std::size_t p = 0; p < plan_.point_count; ++p) bundle_.contact_paths[p] = 0;
    far_contact_path_ = HUGE_DISTANCE;
  }

  // Number of strands with a set bit, without padding.
  unsigned count_strands(unsigned bits) const {
    unsigned result = 0;
    for (bits &= bundle_.strand_bits; bits; bits &= bits - 1) ++result;
    return result;
  }

  // Moves four particles out of colliders; returns the bits of those that moved.
  unsigned resolve(std::size_t step, std::size_t p, double displacement) {
    double &path_length = bundle_.path_lengths[p],
           *paths = bundle_.collider_paths + p * plan_.collider_count;
    const V from = load_vector(bundle_.before, p);
    V to = load_vector(bundle_.x, p), reference = load_vector(bundle_.reference_positions, p);
    unsigned moved_bits = sweep(step, p, displacement, from, to);
    for (int iteration = 0; iteration < MAX_COLLIDER_ITERATIONS; ++iteration) {
      unsigned pushed_bits = 0;
      std::size_t tested_count = 0, last_tested_collider = 0;
      for (std::size_t k = 0; k < near_count_; ++k) {
        const std::size_t c = bundle_.near_colliders[k];
        if (paths[c] > path_length) continue;
        ++tested_count;
        last_tested_collider = c;
        pushed_bits |= push(step, p, c, from, to, reference);
      }
      // A particle that is pushed may come near colliders that were far away.
      if (path_length >= far_contact_path_) include_all_colliders();
      moved_bits |= pushed_bits;
      if (!pushed_bits ||
          (tested_count == 1 && !may_touch_any(paths, path_length, last_tested_collider)))
        break;
    }
    bundle_.contact_paths[p] = next_contact_path(p);
    to.store(bundle_.x + FOUR_VEC_SIZE * p);
    reference.store(bundle_.reference_positions + FOUR_VEC_SIZE * p);
    return moved_bits;
  }

  // Whether any nearby collider but one may be touched at a path length.
  bool may_touch_any(const double* paths, double path_length, std::size_t excluded_collider) const {
    for (std::size_t k = 0; k < near_count_; ++k)
      if (bundle_.near_colliders[k] != excluded_collider &&
          paths[bundle_.near_colliders[k]] <= path_length)
        return true;
    return false;
  }

  // Moves four particles out of one collider; returns the bits of those that moved.
  unsigned push(std::size_t step, std::size_t p, std::size_t c, const V& from, V& to,
                V& reference) {
    const std::size_t row = step * plan_.collider_count + c;
    const collide::MovingCapsule& capsule = plan_.capsules[row];
    double &path_length = bundle_.path_lengths[p],
           &contact_path = bundle_.collider_paths[p * plan_.collider_count + c];
    const auto hit = sample(row, c, true, to);
    const double remaining_shift = plan_.remaining_shifts[row + plan_.collider_count];
    const double nearest_distance = smallest(hit.distance);
    contact_path = plan_.is_bounded[c] && nearest_distance > remaining_shift
                       ? path_length + (nearest_distance - remaining_shift)
                       : path_length;
    if (!(nearest_distance < -collide::TOUCH_DISTANCE)) return 0;
    const N depth = allowed_depths(p, c);
    if (!(smallest(hit.distance - depth) < -collide::TOUCH_DISTANCE)) return 0;
    const N start_distance = sample(row, c, false, from).distance;
    V new_position = to, new_reference = reference;
    const unsigned pushed_bits =
        selected_strand_bits_ &
        collide::push_out(capsule, hit, start_distance, depth, from, new_position, new_reference);
    if (!pushed_bits) return 0;
    new_position = select(selected_mask_, new_position, to);
    reference = select(selected_mask_, new_reference, reference);
    path_length += largest(length(new_position - to));
    contact_path = path_length;
    to = new_position;
    return pushed_bits;
  }

  // Allowed depths of four particles in a collider.
  N allowed_depths(std::size_t p, std::size_t c) const {
    if (!bundle_.depths[0] || c >= plan_.depth_row_count) return N(0.0);
    double values[SIMD_WIDTH];
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l)
      values[l] = bundle_.depths[l][c * bundle_.depth_stride + p];
    return N::load(values);
  }

  // Distances of four points from a collider at the start or the end of a step.
  collide::WideSample<N> sample(std::size_t row, std::size_t c, bool is_at_end,
                                const V& position) const {
    const collide::MovingCapsule& capsule = plan_.capsules[row];
    if (plan_.is_capsule[c])
      return collide::sample_moving_capsule(is_at_end ? capsule.end : capsule.begin, capsule.radius,
                                            position);
    double points[FOUR_VEC_SIZE], samples[SIMD_WIDTH][SIMD_WIDTH];
    position.store(points);
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l) {
      const double point[3] = {points[l], points[SIMD_WIDTH + l], points[2 * SIMD_WIDTH + l]};
      plan_.general_colliders.sample(plan_.general_colliders.context, row, is_at_end, point,
                                     samples[l]);
    }
    double columns[SIMD_WIDTH][SIMD_WIDTH];
    for (std::size_t k = 0; k < SIMD_WIDTH; ++k)
      for (std::size_t l = 0; l < SIMD_WIDTH; ++l) columns[k][l] = samples[l][k];
    return {N::load(columns[0]), {N::load(columns[1]), N::load(columns[2]), N::load(columns[3])}};
  }

  // Stops particles that move farther than the thickness of a collider in a step (continuous
  // collision). Returns the bits of those that stopped.
  unsigned sweep(std::size_t step, std::size_t p, double displacement, const V& from, V& to) {
    double &path_length = bundle_.path_lengths[p],
           *paths = bundle_.collider_paths + p * plan_.collider_count;
    unsigned stopped_bits = 0;
    for (std::size_t k = 0; k < near_count_; ++k) {
      const std::size_t c = bundle_.near_colliders[k];
      if (paths[c] > path_length || displacement <= plan_.thicknesses[c]) continue;
      double begins[FOUR_VEC_SIZE], ends[FOUR_VEC_SIZE];
      from.store(begins);
      to.store(ends);
      for (std::size_t l = 0; l < SIMD_WIDTH; ++l) {
        const double begin[3] = {begins[l], begins[SIMD_WIDTH + l], begins[2 * SIMD_WIDTH + l]};
        double end[3] = {ends[l], ends[SIMD_WIDTH + l], ends[2 * SIMD_WIDTH + l]};
        const std::size_t row = step * plan_.collider_count + c;
        if (!(selected_strand_bits_ >> l & 1)) continue;
        if (!plan_.general_colliders.sweep(plan_.general_colliders.context, row, begin, end))
          continue;
        for (std::size_t k = 0; k < 3; ++k) ends[k * SIMD_WIDTH + l] = end[k];
        stopped_bits |= 1u << l;
      }
      const V new_position = V::load(ends);
      path_length += largest(length(new_position - to));
      to = new_position;
    }
    return stopped_bits;
  }

  // Number of particles that remain inside colliders.
  std::int64_t count_inside() const {
    std::int64_t inside_count = 0;
    const std::size_t steps = plan_.interval_count * plan_.substeps;
    for (std::size_t p = 1; p < plan_.point_count; ++p) {
      unsigned deep_bits = 0;
      for (std::size_t k = 0; k < near_count_; ++k) {
        const std::size_t c = bundle_.near_colliders[k];
        if (bundle_.collider_paths[p * plan_.collider_count + c] > bundle_.path_lengths[p])
          continue;
        const std::size_t row = (steps - 1) * plan_.collider_count + c;
        const N excess =
            sample(row, c, true, load_vector(bundle_.x, p)).distance - allowed_depths(p, c);
        deep_bits |= mask_bits(less(excess, N(-plan_.inside_tolerance)));
      }
      inside_count += count_strands(deep_bits);
    }
    return inside_count;
  }

  // Largest strain of springs along the strands.
  double max_strain() const {
    N largest_strain(0.0);
    for (std::size_t p = 1; p < plan_.point_count; ++p) {
      const V d = load_vector(bundle_.x, p) - load_vector(bundle_.x, p - 1);
      const N rest_length = N::load(bundle_.rest_lengths + SIMD_WIDTH * (p - 1));
      const N strain = sqrt(dot(d, d)) * inverse(rest_length) - 1.0;
      largest_strain = max(strain, largest_strain);
    }
    return largest(largest_strain);
  }

  static constexpr double HUGE_DISTANCE = 1e300;
  static constexpr unsigned ALL_STRANDS = 15;

  const StrandSteps& plan_;
  StrandBundle& bundle_;
  // Animated positions of the strands at the start of the current interval; fractions of the
  // interval at the start and the end of the step.
  const double* interval_goals_ = nullptr;
  double begin_fraction_ = 0, end_fraction_ = 0;
  // Number of nearby colliders, and the path length at which any other collider may be touched.
  std::size_t near_count_ = 0;
  double far_contact_path_ = 0;
  // The strands that colliders may move.
  N selected_mask_{0.0};
  unsigned selected_strand_bits_ = 0;
};

template <class Simd>
void advance_bundle(const StrandSteps& plan, StrandBundle& bundle) {
  BundleSolver<Simd>(plan, bundle).advance();
}

}  // namespace animtool
