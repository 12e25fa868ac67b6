// Advances strands over a frame, four at a time from its start to its end, so that their data stays
// in the cache.
#include "springs/strands.h"

#include <algorithm>
#include <cmath>
#include <system_error>
#include <thread>

#include "base/checks.h"
#include "springs/loops.h"
#include "springs/steps.h"

namespace animtool {

namespace {

using collide::load;
using collide::store;
using collide::Vec;

std::size_t count_bundles(std::size_t strands) { return (strands + SIMD_WIDTH - 1) / SIMD_WIDTH; }

// Index of a strand; padding strands repeat the last one.
std::size_t strand_of(std::size_t bundle, std::size_t lane, std::size_t strands) {
  return std::min(bundle * SIMD_WIDTH + lane, strands - 1);
}

// Rows of strands (S, count), interleaved by bundle and padded to `width`.
std::vector<double> interleave(In<double, 2> rows, std::size_t strands, std::size_t width) {
  std::vector<double> result(count_bundles(strands) * SIMD_WIDTH * width);
  for (std::size_t b = 0; b < count_bundles(strands); ++b)
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l)
      for (std::size_t k = 0; k < rows.shape(1); ++k)
        result[(b * width + k) * SIMD_WIDTH + l] =
            rows.data()[strand_of(b, l, strands) * rows.shape(1) + k];
  return result;
}

// The colliders of all steps of a frame, as functions on bundles read them.
class FrameColliders {
 public:
  // The common drift is the displacement of the first particle, whose path is given.
  FrameColliders(const MovingColliders& colliders, const std::optional<SpringColliders>& arrays,
                 std::size_t interval_count, int substeps, double h, const double* targets,
                 std::size_t particles)
      : colliders_(colliders), h_(h), collider_count_(colliders.size()) {
    const auto surfaces = arrays ? std::get<5>(*arrays).size() : 0;
    collider_count_ += surfaces;
    surfaces_.reserve(surfaces * interval_count);
    std::vector<StepCollider> rigid_steps;
    for (std::size_t interval = 0; interval < interval_count; ++interval) {
      const double* positions = targets + 3 * particles * interval;
      double drift[3];
      for (std::size_t k = 0; k < 3; ++k)
        drift[k] = (positions[3 * particles + k] - positions[k]) / substeps;
      rigid_steps.clear();
      colliders.append_steps(static_cast<std::int64_t>(interval), substeps, h, rigid_steps);
      for (std::size_t s = 0; s < surfaces; ++s) {
        surfaces_.emplace_back(std::get<5>(*arrays)[s], static_cast<std::int64_t>(interval_count));
        surfaces_.back().begin_interval(static_cast<std::int64_t>(interval), h * substeps);
      }
      for (int step = 0; step < substeps; ++step) {
        const auto first =
            rigid_steps.begin() + step * static_cast<std::ptrdiff_t>(colliders.size());
        step_colliders_.insert(step_colliders_.end(), first,
                               first + static_cast<std::ptrdiff_t>(colliders.size()));
        for (std::size_t s = 0; s < surfaces; ++s)
          step_colliders_.push_back(surface_step(surfaces_[surfaces_.size() - surfaces + s],
                                                 static_cast<std::int32_t>(s), step, substeps,
                                                 load(drift)));
        drifts_.insert(drifts_.end(), drift, drift + 3);
      }
    }
    for (const StepCollider& collider : step_colliders_) capsules_.push_back(collider.capsule);
    for (std::size_t c = 0; c < collider_count_; ++c) {
      thicknesses_.push_back(step_colliders_[c].thickness(colliders.radius()));
      is_capsule_.push_back(step_colliders_[c].is_capsule);
      is_bounded_.push_back(step_colliders_[c].is_capsule || step_colliders_[c].surface >= 0);
    }
    fill_remaining_shifts();
  }

  const StepCollider& row(std::size_t step, std::size_t c) const {
    return step_colliders_[step * collider_count_ + c];
  }

  // Sets the collider arrays of a frame.
  void fill(StrandSteps& plan) const {
    plan.collider_count = collider_count_;
    plan.capsules = capsules_.data();
    plan.is_capsule = is_capsule_.data();
    plan.is_bounded = is_bounded_.data();
    plan.depth_row_count = colliders_.depth_row_count();
    plan.thicknesses = thicknesses_.data();
    plan.drifts = drifts_.data();
    plan.remaining_shifts = remaining_shifts_.data();
    plan.general_colliders = {this, &FrameColliders::sample, &FrameColliders::sweep};
    plan.inside_tolerance = colliders_.inside_tolerance();
  }

 private:
  // One step of a moving mesh; for friction its surface moves with the drift.
  StepCollider surface_step(const MovingSurface& mesh, std::int32_t index, int step, int substeps,
                            Vec drift) const {
    StepCollider result{};
    result.surface = index;
    result.elapsed = mesh.knot_fraction(double(step) / substeps);
    const double end_fraction = mesh.knot_fraction(double(step + 1) / substeps);
    result.duration = end_fraction - result.elapsed;
    result.collider = mesh.collider(end_fraction);
    result.max_point_shift = mesh.max_relative_displacement(drift, result.duration);
    result.capsule.friction = result.collider.friction;
    result.capsule.max_push = result.collider.depenetration * h_;
    store(drift, result.capsule.translation);
    return result;
  }

  // Sums bounds of the surface displacements from each step to the end of the frame.
  void fill_remaining_shifts() {
    const std::size_t count = collider_count_;
    remaining_shifts_.assign(step_colliders_.size() + count, 0.0);
    for (std::size_t row = step_colliders_.size(); row-- > 0;) {
      const Vec drift = load(&drifts_[3 * (row / count)]);
      remaining_shifts_[row] = remaining_shifts_[row + count];
      if (step_colliders_[row].is_capsule)
        remaining_shifts_[row] += step_colliders_[row].max_displacement(drift);
      if (step_colliders_[row].surface >= 0)
        remaining_shifts_[row] += step_colliders_[row].max_point_shift;
    }
  }

  static void sample(const void* context, std::size_t row, bool is_at_end, const double* point,
                     double* distance_and_normal) {
    const auto& self = *static_cast<const FrameColliders*>(context);
    const StepCollider& collider = self.step_colliders_[row];
    const double radius = self.colliders_.radius();
    const auto hit = is_at_end ? collider.sample_end(load(point), radius)
                               : collider.sample_start(load(point), radius);
    distance_and_normal[0] = hit.distance;
    store(hit.normal, distance_and_normal + 1);
  }

  static bool sweep(const void* context, std::size_t row, const double* from, double* to) {
    const auto& self = *static_cast<const FrameColliders*>(context);
    Vec end_position = load(to);
    const double radius = self.colliders_.radius();
    if (!self.step_colliders_[row].sweep(self.h_, radius, load(from), end_position, nullptr))
      return false;
    store(end_position, to);
    return true;
  }

  const MovingColliders& colliders_;
  double h_;
  std::size_t collider_count_;                // rigid colliders and moving meshes
  std::vector<MovingSurface> surfaces_;       // (intervals, S)
  std::vector<StepCollider> step_colliders_;  // (steps, C)
  std::vector<collide::MovingCapsule> capsules_;
  std::vector<double> drifts_, remaining_shifts_, thicknesses_;
  std::vector<unsigned char> is_capsule_, is_bounded_;
};

// Advances one bundle at a time, with its buffers and the arrays of the frame.
class BundleWorker {
 public:
  BundleWorker(const SpringStrands& strands, const StrandSteps& plan,
               const MovingColliders& colliders, const FrameColliders& frame,
               const CarrierColliders& carrier_colliders, const double* targets,
               const double* state, double* out)
      : strands_(strands),
        plan_(plan),
        colliders_(colliders),
        frame_colliders_(frame),
        targets_(targets),
        state_(state),
        out_(out),
        rows_(6 * width()),
        goals_((plan.interval_count + 1) * width()),
        path_buffers_(plan.point_count * (plan.collider_count + 2)),
        near_colliders_(plan.collider_count),
        touched_counts_(plan.interval_count * plan.substeps),
        segment_particles_(plan.point_count),
        strand_positions_before_(PARTICLE_STRIDE * plan.point_count),
        strand_positions_(PARTICLE_STRIDE * plan.point_count) {
    for (const SpringElements& elements : strands.segments()) {
      FaceContacts& segments = segments_.emplace_back(elements, colliders.radius());
      for (std::size_t c = 0; c < colliders.size(); ++c)
        if (c >= carrier_colliders.first && c < carrier_colliders.first + carrier_colliders.second)
          segments.add_without_features();
        else
          segments.add(colliders[c]);
    }
  }

  void advance(std::size_t index) {
    StrandBundle bundle = build_bundle(index);
    spring_functions().advance_bundle(plan_, bundle);
    store_strands(index, bundle.x, out_);
    store_strands(index, bundle.v, out_ + 3 * particle_count());
    inside_count += bundle.inside_count;
    max_strain = std::max(max_strain, bundle.max_strain);
  }

  std::int64_t touched_count(std::size_t step) const { return touched_counts_[step]; }
  std::int64_t inside_count = 0;
  double max_strain = 0;

 private:
  std::size_t width() const { return FOUR_VEC_SIZE * plan_.point_count; }
  std::size_t particle_count() const { return strands_.strand_count() * plan_.point_count; }

  StrandBundle build_bundle(std::size_t index) {
    StrandBundle bundle{};
    bundle.x = rows_.data();
    bundle.v = bundle.x + width();
    bundle.before = bundle.v + width();
    bundle.directions = bundle.before + width();
    bundle.matrix = bundle.directions + width();
    bundle.reference_positions = bundle.matrix + width();
    bundle.rest_lengths = strands_.rest_lengths(index);
    bundle.bend_lengths = strands_.bend_lengths(index);
    bundle.path_lengths = path_buffers_.data();
    bundle.contact_paths = bundle.path_lengths + plan_.point_count;
    bundle.collider_paths = bundle.contact_paths + plan_.point_count;
    bundle.near_colliders = near_colliders_.data();
    bundle.touched_counts = touched_counts_.data();
    bundle.segment_particles = segment_particles_.data();
    first_strand_ = index * SIMD_WIDTH;
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l) {
      const FaceContacts& segments = segments_of(l);
      if (!segments.has_features()) continue;
      const double search_distance =
          std::max(bundle.segments.search_distance, segments.search_distance());
      bundle.segments = {this, &BundleWorker::resolve_segments, search_distance};
    }
    bundle.depth_stride = particle_count();
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l) {
      if (index * SIMD_WIDTH + l < strands_.strand_count()) bundle.strand_bits |= 1u << l;
      if (!colliders_.depths()) continue;
      const std::size_t strand = strand_of(index, l, strands_.strand_count());
      bundle.depths[l] = colliders_.depths() + strand * plan_.point_count;
    }
    load_strands(index, state_, bundle.x);
    load_strands(index, state_ + 3 * particle_count(), bundle.v);
    for (std::size_t k = 0; k <= plan_.interval_count; ++k)
      load_strands(index, targets_ + k * 3 * particle_count(), goals_.data() + k * width());
    bundle.goals = goals_.data();
    return bundle;
  }

  // Collides the segments of one strand with rigid colliders.
  static bool resolve_segments(void* context, StrandBundle& bundle, std::size_t step,
                               std::size_t lane, std::size_t near_count) {
    auto& self = *static_cast<BundleWorker*>(context);
    FaceContacts& segments = self.segments_of(lane);
    if (!segments.has_features()) return false;
    const std::size_t points = self.plan_.point_count;
    self.near_particles_.assign(bundle.segment_particles, bundle.segment_particles + near_count);
    const auto for_each_coordinate = [&](auto&& copy) {
      for (std::size_t p = 0; p < points; ++p)
        for (std::size_t k = 0; k < 3; ++k)
          copy(PARTICLE_STRIDE * p + k, FOUR_VEC_SIZE * p + SIMD_WIDTH * k + lane);
    };
    for_each_coordinate([&](std::size_t to, std::size_t from) {
      self.strand_positions_before_[to] = bundle.reference_positions[from],
      self.strand_positions_[to] = bundle.x[from];
    });
    bool has_moved = false;
    for (std::size_t c = 0; c < self.colliders_.size(); ++c) {
      if (!segments.resolve(c, self.frame_colliders_.row(step, c), self.plan_.h,
                            self.near_particles_,
                            {self.strand_positions_before_, self.strand_positions_, nullptr}))
        continue;
      has_moved = true;
      for (const FaceContacts::MovedParticle& moved_particle : segments.moved_particles)
        bundle.path_lengths[static_cast<std::size_t>(moved_particle.particle)] +=
            moved_particle.displacement;
    }
    if (has_moved)
      for_each_coordinate([&](std::size_t from, std::size_t to) {
        bundle.reference_positions[to] = self.strand_positions_before_[from],
        bundle.x[to] = self.strand_positions_[from];
      });
    return has_moved;
  }

  FaceContacts& segments_of(std::size_t lane) {
    return segments_[strands_.segments_of(
        strand_of(first_strand_ / SIMD_WIDTH, lane, strands_.strand_count()))];
  }

  // Converts rows of particles (N, 3) to interleaved rows of a bundle, and back.
  void load_strands(std::size_t index, const double* rows, double* out) const {
    for (std::size_t l = 0; l < SIMD_WIDTH; ++l) {
      const std::size_t strand = strand_of(index, l, strands_.strand_count());
      const double* row = rows + 3 * plan_.point_count * strand;
      for (std::size_t k = 0; k < 3 * plan_.point_count; ++k) out[SIMD_WIDTH * k + l] = row[k];
    }
  }
  void store_strands(std::size_t index, const double* rows, double* out) const {
    for (std::size_t l = 0; l < SIMD_WIDTH && index * SIMD_WIDTH + l < strands_.strand_count();
         ++l) {
      double* row = out + 3 * plan_.point_count * (index * SIMD_WIDTH + l);
      for (std::size_t k = 0; k < 3 * plan_.point_count; ++k) row[k] = rows[SIMD_WIDTH * k + l];
    }
  }

  const SpringStrands& strands_;
  const StrandSteps& plan_;
  const MovingColliders& colliders_;
  const FrameColliders& frame_colliders_;
  std::vector<FaceContacts> segments_;
  std::size_t first_strand_ = 0;  // of the bundle
  const double *targets_, *state_;
  double* out_;
  std::vector<double> rows_, goals_, path_buffers_;
  std::vector<std::size_t> near_colliders_;
  std::vector<std::int64_t> touched_counts_;
  std::vector<std::int32_t> segment_particles_, near_particles_;
  std::vector<double> strand_positions_before_, strand_positions_;  // rows of one strand
};

// Smallest number of bundles per thread.
constexpr std::size_t MIN_BUNDLES_PER_THREAD = 16;

// Advances all bundles in several threads; results do not depend on the number of threads.
void advance_all(std::vector<BundleWorker>& workers, std::size_t bundle_count) {
  const auto run_worker = [&](std::size_t w) {
    const std::size_t end = (w + 1) * bundle_count / workers.size();
    for (std::size_t b = w * bundle_count / workers.size(); b < end; ++b) workers[w].advance(b);
  };
  std::vector<std::thread> threads;
  threads.reserve(workers.size());
  for (std::size_t w = 1; w < workers.size(); ++w) {
    try {
      threads.emplace_back(run_worker, w);
    } catch (const std::system_error&) {
      run_worker(w);
    }
  }
  run_worker(0);
  for (std::thread& thread : threads) thread.join();
}

// Fraction of an elongation that a spring corrects in a step; stiffness and damping are per mass.
double correction_fraction(double stiffness, double damping, double weight, double h) {
  return stiffness * h * h / ((stiffness * h * h + damping * h) * weight + 1);
}

}  // namespace

SpringStrands::SpringStrands(In<double, 2> spring_rest_lengths, In<double, 2> fold_rest_lengths,
                             In<double, 1> gravity, double drag, double stiffness,
                             double fold_stiffness, double goal_stiffness, double goal_damping,
                             double max_strain)
    : strands_(spring_rest_lengths.shape(0)),
      points_(spring_rest_lengths.shape(1) + 1),
      drag_(drag),
      stiffness_(stiffness),
      bend_stiffness_(fold_stiffness),
      goal_stiffness_(goal_stiffness),
      goal_damping_(goal_damping),
      max_strain_(max_strain) {
  check::shape("rests", spring_rest_lengths, {check::ANY, check::ANY});
  if (strands_ == 0) check::refuse("rests", "there is no strand");
  check::at_most("rests", points_, check::MAX_ROWS / strands_);
  for (std::size_t k = 0; k < spring_rest_lengths.size(); ++k)
    check::non_negative("rests", spring_rest_lengths.data()[k]);
  check::shape("folds", fold_rest_lengths, {strands_, points_ - std::min<std::size_t>(points_, 2)});
  for (std::size_t k = 0; k < fold_rest_lengths.size(); ++k)
    check::non_negative("folds", fold_rest_lengths.data()[k]);
  check::numbers("gravity", gravity, {3});
  check::finite("drag", drag);
  check::non_negative("stiffness", stiffness);
  check::non_negative("fold_stiffness", fold_stiffness);
  check::non_negative("draw_stiffness", goal_stiffness);
  check::non_negative("draw_damping", goal_damping);
  check::non_negative("stretch", max_strain);
  std::copy_n(gravity.data(), 3, gravity_);
  rest_lengths_ = interleave(spring_rest_lengths, strands_, spring_count());
  bend_lengths_ = interleave(fold_rest_lengths, strands_, points_);
  group_segments(spring_rest_lengths);
}

// Groups strands by their longest spring, for segment contacts. Lengths are rounded up to powers of
// two, so that a strand collides as if it were alone.
void SpringStrands::group_segments(In<double, 2> spring_rest_lengths) {
  SpringElements elements;
  elements.inverse_masses.assign(points_, 1.0);
  elements.inverse_masses.front() = 0;
  for (std::size_t p = 0; p < spring_count(); ++p)
    for (const std::size_t end : {p, p + 1})
      elements.edges.push_back(static_cast<std::int32_t>(end));
  for (std::size_t s = 0; s < strands_; ++s) {
    const double* row = spring_rest_lengths.data() + s * spring_count();
    const double longest = spring_count() ? *std::max_element(row, row + spring_count()) : 0.0;
    int exponent = 0;
    if (longest > 0) std::frexp(longest, &exponent);
    elements.longest_edge = longest > 0 ? std::ldexp(1.0, exponent) : 0.0;
    const auto group = std::find_if(segments_.begin(), segments_.end(), [&](const auto& other) {
      return other.longest_edge == elements.longest_edge;
    });
    group_of_strand_.push_back(static_cast<std::size_t>(group - segments_.begin()));
    if (group == segments_.end()) segments_.push_back(elements);
  }
}

StrandSteps SpringStrands::plan_frame(std::size_t interval_count, std::size_t substeps,
                                      double frame_duration) const {
  StrandSteps result{};
  result.point_count = points_;
  result.interval_count = interval_count;
  result.substeps = substeps;
  const double h = frame_duration / static_cast<double>(interval_count * substeps);
  result.h = h;
  for (std::size_t k = 0; k < 3; ++k) result.gravity_step[k] = h * gravity_[k];
  result.drag_factor = 1 / (1 + h * drag_);
  result.bend_factor = correction_fraction(bend_stiffness_, 0, 2, h);
  result.root_bend_factor = correction_fraction(bend_stiffness_, 0, 1, h);
  result.goal_pull_factor = correction_fraction(goal_stiffness_, goal_damping_, 1, h);
  result.goal_damping_factor =
      goal_damping_ * h / ((goal_stiffness_ * h * h + goal_damping_ * h) + 1);
  result.along_compliance = 1 / (stiffness_ * h * h);
  result.max_length_ratio = 1 + max_strain_;
  return result;
}

StrandResult follow_strands(const SpringStrands& strands, In<double, 3> targets,
                            In<double, 3> state, double frame_duration, int substeps,
                            const std::optional<SpringColliders>& colliders,
                            std::size_t thread_count, const CarrierColliders& carrier_colliders) {
  const std::size_t count = strands.strand_count() * strands.point_count();
  check::numbers("state", state, {2, count, 3});
  check::shape("targets", targets, {check::ANY, count, 3});
  if (targets.shape(0) < 2) check::refuse("targets", "there is no interval between two of them");
  check::finite("targets", targets);
  if (thread_count < 1) check::refuse("thread_count", "0 is none");
  const std::size_t interval_count = targets.shape(0) - 1;
  check::positive("frame_duration", frame_duration);
  check_intervals({0, 0, frame_duration / static_cast<double>(interval_count),
                   static_cast<std::int64_t>(interval_count)},
                  substeps);
  const MovingColliders moving_colliders(colliders, count,
                                         static_cast<std::int64_t>(interval_count));
  Out<double, 3> out(2, count, 3);
  std::int64_t max_touched = 0, inside_count = 0;
  double max_strain = 0;
  StrandSteps plan =
      strands.plan_frame(interval_count, static_cast<std::size_t>(substeps), frame_duration);
  const FrameColliders frame(moving_colliders, colliders, interval_count, substeps, plan.h,
                             targets.data(), count);
  frame.fill(plan);
  const std::size_t bundle_count = count_bundles(strands.strand_count());
  const std::size_t max_workers = std::max<std::size_t>(1, bundle_count / MIN_BUNDLES_PER_THREAD);
  std::vector<BundleWorker> workers;
  workers.reserve(std::min(thread_count, max_workers));
  while (workers.size() < std::min(thread_count, max_workers))
    workers.emplace_back(strands, plan, moving_colliders, frame, carrier_colliders, targets.data(),
                         state.data(), out.get());
  advance_all(workers, bundle_count);
  for (std::size_t step = 0; step < interval_count * static_cast<std::size_t>(substeps); ++step) {
    std::int64_t step_count = 0;
    for (const BundleWorker& worker : workers) step_count += worker.touched_count(step);
    max_touched = std::max(max_touched, step_count);
  }
  for (const BundleWorker& worker : workers) {
    inside_count += worker.inside_count;
    max_strain = std::max(max_strain, worker.max_strain);
  }
  return {std::move(out), max_touched, inside_count, max_strain};
}

}  // namespace animtool
