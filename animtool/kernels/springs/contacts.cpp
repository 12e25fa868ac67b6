// Particles of springs against colliders.
#include "springs/contacts.h"

#include <algorithm>

#include "base/checks.h"

namespace animtool {

namespace {

using collide::Collider;
using collide::load;
using collide::Mesh;
using collide::Motion;
using collide::MovingCapsule;
using collide::Pose;
using collide::Sample;
using collide::Shape;
using collide::store;
using collide::Vec;

// Impact speed below which a contact is at rest [speed that gravity adds in a step].
constexpr double RESTING_SPEED_FACTOR = 2;
// Iterations over all colliders.
constexpr int MAX_COLLIDER_ITERATIONS = 3;
// Numbers per collider: impulse, moment, mass.
constexpr std::size_t IMPULSE_WIDTH = 7;
// Factor of the radius for edge midpoints, which cut corners.
constexpr double MIDPOINT_FACTOR = 0.25;
// Points of moving meshes are fine if their radius of curvature plus the contact distance is below
// this fraction of the longest edge: they fit between particles and midpoints. Factor of the
// contact distance for triangles; and the size of groups of fine points [longest edge].
constexpr double FINE_RADIUS_FRACTION = 0.35, FINE_POINT_FACTOR = 0.5, FINE_GROUP_SIZE = 3;
// Safety factor of the distance that a triangle moves in an interval.
constexpr double FINE_REACH = 1.5;
// Fraction of its clearance from fine points by which a triangle may move relative to the nearest
// one: the others move a little differently.
constexpr double FINE_CLEARANCE_FRACTION = 0.5;
// Largest number of fine points of a group that a triangle collides with in a step.
constexpr int MAX_FINE_POINTS = 3;
// Smallest initial slack of mesh caches, over the size of the mesh.
constexpr double MIN_SLACK_RATIO = 1e-3;
// Factor of the initial slack: with a large slack, a fine mesh has too many triangles nearby.
constexpr double SLACK_FACTOR = 0.25;

// Largest displacement of a particle that cannot pass through a collider.
double thickness_of(const Collider& c, double radius) {
  if (c.is_container) return collide::INF;
  switch (c.shape) {
    case Shape::PLANE:
      return collide::INF;
    case Shape::SPHERE:
      return c.size[3];
    case Shape::CAPSULE:
      return c.size[6];
    case Shape::BOX:
      return std::min({c.size[0], c.size[1], c.size[2]});
    // A shorter step at most takes a particle to the surface.
    case Shape::MESH:
      return collide::contact_distance(c, radius);
  }
  return 0;
}

// Adds the impulses of two time intervals; takes the larger mass.
std::vector<double> sum_impulses(const std::vector<double>& first,
                                 const std::vector<double>& second) {
  std::vector<double> sum(first);
  for (std::size_t k = 0; k < sum.size(); ++k)
    sum[k] =
        k % IMPULSE_WIDTH == IMPULSE_WIDTH - 1 ? std::max(sum[k], second[k]) : sum[k] + second[k];
  return sum;
}

MovingCapsule::Axis axis_between(Vec a, Vec b) {
  MovingCapsule::Axis axis;
  const Vec vector = b - a;
  const double squared = dot(vector, vector);
  store(a, axis.start);
  store(vector, axis.vector);
  axis.inverse_squared_length = squared > 0 ? 1 / squared : 0;
  const Vec outward =
      squared > 0 ? collide::orthogonal(vector * (1 / std::sqrt(squared))) : Vec{0, 1, 0};
  store(outward, axis.outward);
  return axis;
}

// Distance of a point from a collider in a pose.
Sample sample_at_pose(const StepCollider& c, const MovingCapsule::Axis& axis, const Pose& pose,
                      Vec point, double radius) {
  if (!c.is_capsule) return sample(c.collider, pose, point, radius, collide::INF);
  const auto hit = collide::sample_moving_capsule(axis, c.capsule.radius, point);
  return {hit.distance, hit.normal};
}

}  // namespace

Sample StepCollider::sample_start(Vec point, double radius) const {
  if (surface >= 0) {
    Collider start_collider = collider;
    start_collider.mesh.fraction = elapsed;
    return sample(start_collider, begin, point, radius, collide::INF);
  }
  return sample_at_pose(*this, capsule.begin, begin, point, radius);
}

Sample StepCollider::sample_end(Vec point, double radius) const {
  return sample_at_pose(*this, capsule.end, end, point, radius);
}

double StepCollider::max_displacement(Vec drift) const {
  if (surface >= 0) return max_point_shift + length(drift);
  if (!is_capsule) return length(collider.motion.translation() - drift);
  // Clamp to the ends of the axis.
  const Vec start_shift = load(capsule.end.start) - load(capsule.begin.start) - drift;
  const Vec end_shift = start_shift + (load(capsule.end.vector) - load(capsule.begin.vector));
  return std::max(length(start_shift), length(end_shift));
}

double StepCollider::thickness(double radius) const { return thickness_of(collider, radius); }

bool StepCollider::sweep(double h, double radius, Vec from, Vec& to, double* v) const {
  // A moving mesh is tested as it is at the end of the step, in a frame that moves with it.
  const Vec translation = surface >= 0 ? load(capsule.translation) : Vec{},
            start = from + translation;
  if (!(length(to - start) > thickness(radius))) return false;
  // Particles that start inside are moved out at the depenetration speed.
  if (sample_start(from, radius).distance < -collide::INSIDE_DEPTH) return false;
  const Vec velocity = (to - start) * (1 / h);
  collide::Particle end{to, velocity};
  collide::ParticleContacts contacts(&collider, 1, h, radius);
  if (contacts.resolve({start, velocity}, end).collider < 0) return false;
  to = end.position;
  if (v) store(end.velocity, v);
  return true;
}

MovingColliders::MovingColliders(const std::optional<SpringColliders>& colliders,
                                 std::size_t particles, std::int64_t interval_count)
    : particles_(particles) {
  if (!colliders) return;
  const auto& [arrays, poses, radius, depths, inside_tolerance, surfaces] = *colliders;
  colliders_ = read_colliders(arrays);
  check::numbers("colliders.poses", poses,
                 {static_cast<std::size_t>(interval_count), colliders_.size(), 2, 7});
  check::non_negative("colliders.radius", radius);
  check::non_negative("colliders.tolerance", inside_tolerance);
  if (depths) {
    const bool has_surfaces = depths->shape(0) == colliders_.size() + surfaces.size();
    depth_row_count_ = colliders_.size() + (has_surfaces ? surfaces.size() : 0);
    check::numbers("colliders.depths", *depths, {depth_row_count_, particles});
  }
  poses_ = poses.data();
  radius_ = radius;
  if (depths) depths_ = depths->data();
  inside_tolerance_ = inside_tolerance;
}

bool MovingColliders::is_continuous(std::int64_t interval) const {
  const std::size_t row_size = 14 * colliders_.size();
  const double* pose = poses(interval);
  for (std::size_t k = 0; k < row_size; k += 14)
    if (!std::equal(pose + k, pose + k + 7, pose + k + 7 - row_size)) return false;
  return true;
}

void MovingColliders::append_steps(std::int64_t interval, int substeps, double h,
                                   std::vector<StepCollider>& out) const {
  std::vector<Motion> interval_motions;
  for (std::size_t c = 0; c < colliders_.size(); ++c) {
    const double* pose = poses(interval) + 14 * c;
    interval_motions.emplace_back(pose, pose + 7);
  }
  for (int step = 0; step < substeps; ++step)
    for (std::size_t c = 0; c < colliders_.size(); ++c)
      out.push_back(step_collider(
          colliders_[c],
          interval_motions[c].sub_motion(double(step) / substeps, double(step + 1) / substeps), h));
}

StepCollider MovingColliders::step_collider(const Collider& c, const Motion& motion,
                                            double h) const {
  StepCollider result{};
  result.collider = c;
  result.collider.motion = motion;
  result.begin = motion.pose_at(0);
  result.end = motion.pose_at(1);
  result.is_capsule = !c.is_container && (c.shape == Shape::CAPSULE || c.shape == Shape::SPHERE);
  MovingCapsule& capsule = result.capsule;
  store(motion.translation(), capsule.translation);
  store(motion.rotation(), capsule.rotation);
  store(result.end.origin, capsule.origin);
  capsule.friction = c.friction;
  capsule.max_push = c.depenetration * h;
  if (!result.is_capsule) return result;
  const bool is_sphere = c.shape == Shape::SPHERE;
  const Vec a = load(c.size), b = is_sphere ? a : load(c.size + 3);
  const Vec a0 = result.begin.to_world(a), b0 = result.begin.to_world(b);
  const Vec a1 = result.end.to_world(a), b1 = result.end.to_world(b);
  capsule.begin = axis_between(a0, b0);
  capsule.end = axis_between(a1, b1);
  capsule.radius = c.size[is_sphere ? 3 : 6] + c.margin + radius_;
  return result;
}

SpringContacts::SpringContacts(const std::optional<SpringColliders>& colliders,
                               const SpringNetwork& network, std::int64_t interval_count,
                               bool has_midpoints)
    : network_(network),
      colliders_(colliders, network.particle_count(), interval_count),
      faces_(network, colliders_.radius()),
      collider_count_(colliders_.size()),
      interval_count_(interval_count),
      has_midpoints_(has_midpoints) {
  if (!colliders) return;
  const std::size_t particles =
      network.particle_count() + (has_midpoints ? network.edges.size() / 2 : 0);
  for (std::size_t c = 0; c < collider_count_; ++c) faces_.add(colliders_[c]);
  for (const SpringSurface& surface : std::get<5>(*colliders)) {
    surfaces_.emplace_back(surface, interval_count);
    if (has_midpoints)
      surfaces_.back().find_fine_points(FINE_RADIUS_FRACTION * network.longest_edge -
                                            colliders_.radius() - surfaces_.back().margin(),
                                        FINE_GROUP_SIZE * network.longest_edge);
  }
  collider_count_ += surfaces_.size();
  build_patches(particles);
  past_impulses_.assign(IMPULSE_WIDTH * colliders_.size(), 0.0);
  interval_impulses_ = past_impulses_;
  clearances_.assign(particles, 0.0);
  lever_arms_.assign(particles, 0.0);
}

void SpringContacts::build_patches(std::size_t particles) {
  for (std::size_t c = 0; c < collider_count_; ++c) {
    const bool is_rigid = c < colliders_.size();
    const double margin =
        is_rigid ? colliders_[c].margin : surfaces_[c - colliders_.size()].margin();
    const double contact_distance = colliders_.radius() + (is_rigid ? margin : 0);
    contact_distances_.push_back(colliders_.radius() + margin);
    const double* box = nullptr;
    if (!is_rigid)
      box = surfaces_[c - colliders_.size()].box();
    else if (colliders_[c].shape == Shape::MESH)
      box = colliders_[c].mesh.bounds + 6 * colliders_[c].mesh_root;
    patch_indices_.push_back(box ? static_cast<std::int32_t>(patches_.size()) : -1);
    if (box)
      patches_.emplace_back(
          particles, SLACK_FACTOR * std::max(contact_distance,
                                             MIN_SLACK_RATIO * length(load(box + 3) - load(box))));
  }
}

void SpringContacts::begin_interval(std::int64_t interval, int substeps, double h) {
  if (!has_colliders()) return;
  substeps_ = substeps;
  h_ = h;
  if (interval != last_interval_) past_impulses_ = sum_impulses(past_impulses_, interval_impulses_);
  std::fill(interval_impulses_.begin(), interval_impulses_.end(), 0.0);
  rigid_steps_.clear();
  colliders_.append_steps(interval, substeps, h, rigid_steps_);
  // A teleported collider invalidates the cache.
  const bool is_repeated = interval == last_interval_;
  bool is_cache_valid = is_repeated || (interval == last_interval_ + 1 &&
                                        (last_interval_ < 0 || colliders_.is_continuous(interval)));
  begin_surfaces(interval, is_cache_valid);
  add_surfaces();
  if (is_repeated) clearances_ = start_clearances_, lever_arms_ = start_lever_arms_;
  if (!is_cache_valid) std::fill(clearances_.begin(), clearances_.end(), 0.0);
  start_clearances_ = clearances_, start_lever_arms_ = lever_arms_;
  last_interval_ = interval;
}

void SpringContacts::begin_surfaces(std::int64_t interval, bool& is_cache_valid) {
  for (std::size_t s = 0; s < surfaces_.size(); ++s) {
    if (surfaces_[s].begin_interval(interval, h_ * substeps_)) continue;
    is_cache_valid = false;
    patches_[static_cast<std::size_t>(patch_indices_[colliders_.size() + s])].invalidate();
  }
}

void SpringContacts::add_surfaces() {
  interval_steps_.clear();
  for (int step = 0; step < substeps_; ++step) {
    const auto first = rigid_steps_.begin() + step * static_cast<std::ptrdiff_t>(colliders_.size());
    interval_steps_.insert(interval_steps_.end(), first,
                           first + static_cast<std::ptrdiff_t>(colliders_.size()));
    for (std::size_t s = 0; s < surfaces_.size(); ++s) {
      StepCollider step_collider{};
      const double start_fraction = surfaces_[s].knot_fraction(double(step) / substeps_);
      const double end_fraction = surfaces_[s].knot_fraction(double(step + 1) / substeps_);
      step_collider.collider = surfaces_[s].collider(end_fraction);
      step_collider.surface = static_cast<std::int32_t>(s);
      step_collider.elapsed = start_fraction;
      step_collider.duration = end_fraction - start_fraction;
      step_collider.max_point_shift = surfaces_[s].max_displacement() * step_collider.duration;
      step_collider.capsule.friction = step_collider.collider.friction;
      step_collider.capsule.max_push = step_collider.collider.depenetration * h_;
      interval_steps_.push_back(step_collider);
    }
  }
}

Out<double, 2> SpringContacts::impulses() const {
  const std::vector<double> sum = sum_impulses(past_impulses_, interval_impulses_);
  Out<double, 2> result(sum.size() / IMPULSE_WIDTH, IMPULSE_WIDTH);
  std::copy(sum.begin(), sum.end(), result.get());
  return result;
}

bool SpringContacts::resolve(int step, std::vector<double>& before, std::vector<double>& x,
                             std::vector<double>* v, std::vector<std::uint8_t>* particle_marks) {
  if (!has_colliders()) return false;
  step_colliders_ = interval_steps_.data() + static_cast<std::size_t>(step) * collider_count_;
  double max_displacement = 0, max_angle = 0;
  for (std::size_t c = 0; c < collider_count_; ++c) {
    max_displacement = std::max(max_displacement, step_colliders_[c].max_displacement({}));
    max_angle = std::max(max_angle, step_colliders_[c].rotation_angle());
  }
  masses_.assign(colliders_.size(), 0.0);
  min_impact_speed_ =
      RESTING_SPEED_FACTOR * h_ * std::sqrt(dot3(network_.gravity, network_.gravity));
  std::int64_t moved_count = 0, inside_count = 0;
  const double search_distance = faces_.search_distance();
  particles_near_colliders_.clear();
  for (std::size_t n = 0; n < network_.particle_count(); ++n) {
    if (network_.inverse_masses[n] == 0) {
      if (faces_.has_features()) particles_near_colliders_.push_back(static_cast<std::int32_t>(n));
      continue;
    }
    if (particle_marks && !(*particle_marks)[n]) continue;
    double *position = x.data() + PARTICLE_STRIDE * n,
           motion_bound = max_displacement + max_angle * lever_arms_[n];
    double* from = before.data() + PARTICLE_STRIDE * n;
    for (std::size_t k = 0; k < 3; ++k) motion_bound += std::abs(position[k] - from[k]);
    clearances_[n] -= motion_bound;
    if (clearances_[n] <= search_distance)
      particles_near_colliders_.push_back(static_cast<std::int32_t>(n));
    if (clearances_[n] > 0) continue;
    const double mass = 1 / network_.inverse_masses[n];
    moved_count +=
        resolve_particle(n, mass, from, position, v ? v->data() + PARTICLE_STRIDE * n : nullptr);
    inside_count += nearest_distance_ < -colliders_.inside_tolerance();
  }
  for (std::size_t c = 0; c < masses_.size(); ++c) {
    double& largest_mass = interval_impulses_[IMPULSE_WIDTH * c + IMPULSE_WIDTH - 1];
    largest_mass = std::max(largest_mass, masses_[c]);
  }
  if (has_midpoints_)
    resolve_midpoints(max_displacement, max_angle, {before, x, v}, particle_marks);
  if (has_midpoints_) {
    if (step == 0 && !particle_marks) list_fine_triangles({before, x, v});
    resolve_fine_points({before, x, v}, particle_marks);
  }
  touched_count = std::max(touched_count, moved_count);
  if (!particle_marks && last_interval_ + 1 == interval_count_ && step + 1 == substeps_)
    unresolved_count = inside_count;
  const bool has_moved_faces =
      !particles_near_colliders_.empty() && resolve_faces({before, x, v}, particle_marks);
  if (has_moved_faces && particle_marks)
    for (const std::int32_t n : particles_near_colliders_)
      (*particle_marks)[static_cast<std::size_t>(n)] = 1;
  return moved_count > 0 || has_moved_faces;
}

void SpringContacts::resolve_midpoints(double max_displacement, double max_angle, StepState state,
                                       std::vector<std::uint8_t>* particle_marks) {
  const std::size_t particles = network_.particle_count();
  for (std::size_t e = 0; e < network_.edges.size() / 2; ++e) {
    const std::int32_t* ends = &network_.edges[2 * e];
    const auto first = static_cast<std::size_t>(ends[0]), last = static_cast<std::size_t>(ends[1]);
    const double p_inverse_mass = network_.inverse_masses[first],
                 q_inverse_mass = network_.inverse_masses[last];
    if (p_inverse_mass + q_inverse_mass == 0) continue;
    if (particle_marks && !(*particle_marks)[first] && !(*particle_marks)[last]) continue;
    double *p = &state.x[PARTICLE_STRIDE * first], *q = &state.x[PARTICLE_STRIDE * last];
    double *p_before = &state.before[PARTICLE_STRIDE * first],
           *q_before = &state.before[PARTICLE_STRIDE * last];
    double midpoint[3], midpoint_before[3],
        motion_bound = max_displacement + max_angle * lever_arms_[particles + e];
    for (std::size_t k = 0; k < 3; ++k) {
      midpoint[k] = (p[k] + q[k]) / 2, midpoint_before[k] = (p_before[k] + q_before[k]) / 2;
      motion_bound += std::abs(midpoint[k] - midpoint_before[k]);
    }
    clearances_[particles + e] -= motion_bound;
    if (clearances_[particles + e] > 0) continue;
    const Vec unpushed_midpoint = load(midpoint), unpushed_midpoint_before = load(midpoint_before);
    if (!resolve_particle(particles + e, 4 / (p_inverse_mass + q_inverse_mass), midpoint_before,
                          midpoint, nullptr))
      continue;
    if (particle_marks) (*particle_marks)[first] = (*particle_marks)[last] = 1;
    const Vec end_shift =
        (load(midpoint) - unpushed_midpoint) * (2 / (p_inverse_mass + q_inverse_mass));
    const Vec start_shift = (load(midpoint_before) - unpushed_midpoint_before) *
                            (2 / (p_inverse_mass + q_inverse_mass));
    clearances_[first] -= p_inverse_mass * length(end_shift),
        clearances_[last] -= q_inverse_mass * length(end_shift);
    store(load(p) + end_shift * p_inverse_mass, p), store(load(q) + end_shift * q_inverse_mass, q);
    store(load(p_before) + start_shift * p_inverse_mass, p_before),
        store(load(q_before) + start_shift * q_inverse_mass, q_before);
  }
}

void SpringContacts::list_fine_triangles(const StepState& state) {
  fine_triangles_.clear();
  if (std::all_of(surfaces_.begin(), surfaces_.end(),
                  [](const MovingSurface& surface) { return surface.fine_nodes().empty(); }))
    return;
  for (std::size_t k = 0; k < network_.triangles.size(); k += 3) {
    const std::int32_t* corners = &network_.triangles[k];
    double travel = 0;
    for (const std::int32_t* n = corners; n < corners + 3; ++n)
      travel = std::max(travel, length(shapes::position_of(state.x.data(), *n) -
                                       shapes::position_of(state.before.data(), *n)));
    const double reach = FINE_REACH * (substeps_ * travel + network_.longest_edge / 8);
    const shapes::Triangle triangle(corners, state.x.data());
    const Vec low = collide::min_of(collide::min_of(triangle.a, triangle.b), triangle.c),
              high = collide::max_of(collide::max_of(triangle.a, triangle.b), triangle.c);
    for (std::size_t s = 0; s < surfaces_.size(); ++s) {
      const std::size_t c = colliders_.size() + s;
      for (const std::int32_t node : surfaces_[s].fine_nodes()) {
        const double* box = surfaces_[s].box() + 6 * node;
        if (collide::boxes_overlap(low, high, load(box), load(box + 3),
                                   reach + contact_distances_[c]))
          fine_triangles_.push_back({k, c, node, surfaces_[s].point_below(node), -1, {}});
      }
    }
  }
}

void SpringContacts::resolve_fine_points(StepState state,
                                         std::vector<std::uint8_t>* particle_marks) {
  for (FineTriangle& fine : fine_triangles_) {
    const std::int32_t* corners = &network_.triangles[fine.corner];
    if (particle_marks && std::none_of(corners, corners + 3, [&](std::int32_t n) {
          return (*particle_marks)[static_cast<std::size_t>(n)];
        }))
      continue;
    if (is_clear(fine, state)) continue;
    const double distance = contact_distances_[fine.collider];
    for (int count = 0; count < MAX_FINE_POINTS; ++count) {
      const double nearest_distance = find_fine_point(fine, state);
      if (nearest_distance >= distance) {
        fine.clearance = nearest_distance - distance;
        break;
      }
      const Vec point = mesh_at(step_colliders_[fine.collider], true).point(fine.point);
      if (!resolve_triangle_point(fine.collider, corners, point, state, particle_marks)) break;
    }
  }
}

bool SpringContacts::is_clear(const FineTriangle& fine, const StepState& state) const {
  if (fine.clearance < 0) return false;
  const Vec point = mesh_at(step_colliders_[fine.collider], true).point(fine.point);
  double motion = 0;
  for (std::size_t k = 0; k < 3; ++k)
    motion = std::max(
        motion, length(shapes::position_of(state.x.data(), network_.triangles[fine.corner + k]) -
                       point - fine.offsets[k]));
  return motion < FINE_CLEARANCE_FRACTION * fine.clearance;
}

double SpringContacts::find_fine_point(FineTriangle& fine, const StepState& state) const {
  const MovingSurface& surface = surfaces_[fine.collider - colliders_.size()];
  const Mesh mesh = mesh_at(step_colliders_[fine.collider], true);
  const double max_distance = 2 * contact_distances_[fine.collider];
  const shapes::Triangle triangle(&network_.triangles[fine.corner], state.x.data());
  const Vec normal = triangle.normal(), centre = (triangle.a + triangle.b + triangle.c) * (1.0 / 3),
            low = collide::min_of(collide::min_of(triangle.a, triangle.b), triangle.c),
            high = collide::max_of(collide::max_of(triangle.a, triangle.b), triangle.c);
  // A lower bound of the squared distance of a box: along the axes, and along the normal.
  const auto squared_bound = [&](Vec box_low, Vec box_high) {
    const Vec gap = collide::max_of(collide::max_of(low - box_high, box_low - high), Vec{}),
              offset = (box_low + box_high) * 0.5 - centre, extent = (box_high - box_low) * 0.5;
    const double height = std::abs(dot(offset, normal)) - std::abs(extent.x * normal.x) -
                          std::abs(extent.y * normal.y) - std::abs(extent.z * normal.z);
    return std::max(dot(gap, gap), height > 0 ? height * height : 0.0);
  };
  double limit = max_distance * max_distance;
  collide::visit_boxes(
      mesh, fine.node, limit,
      [&](std::int32_t node) {
        const auto [box_low, box_high] = surface.box_at(node, mesh.fraction);
        return squared_bound(box_low, box_high);
      },
      [&](std::int32_t t) {
        for (const std::int32_t* p = mesh.triangles + 3 * t; p < mesh.triangles + 3 * t + 3; ++p) {
          if (!surface.is_fine(*p)) continue;
          const Vec point = mesh.point(*p);
          if (squared_bound(point, point) >= limit) continue;
          const Vec offset = triangle.nearest(point).offset;
          if (dot(offset, offset) < limit) limit = dot(offset, offset), fine.point = *p;
        }
        return limit;
      });
  const Vec point = mesh.point(fine.point);
  fine.offsets = {triangle.a - point, triangle.b - point, triangle.c - point};
  fine.clearance = -1;
  return std::sqrt(limit);
}

bool SpringContacts::resolve_triangle_point(std::size_t c, const std::int32_t* corners, Vec nearby,
                                            StepState& state,
                                            std::vector<std::uint8_t>* particle_marks) {
  const StepCollider& collider = step_colliders_[c];
  const double distance = contact_distances_[c];
  const shapes::Nearest nearest = shapes::Triangle(corners, state.x.data()).nearest(nearby);
  Vec from, to;
  double weights[3], total_weight = 0, allowed_depth = 0;
  for (std::size_t k = 0; k < 3; ++k) {
    const auto n = static_cast<std::size_t>(corners[k]);
    weights[k] = -nearest.coefficients[k + 1];
    from = from + load(&state.before[PARTICLE_STRIDE * n]) * weights[k];
    to = to + load(&state.x[PARTICLE_STRIDE * n]) * weights[k];
    total_weight += network_.inverse_masses[n] * weights[k] * weights[k];
    allowed_depth = std::min(allowed_depth, colliders_.depth(c, n));
  }
  if (!(total_weight > 0)) return false;
  allowed_depth -= distance * (1 - FINE_POINT_FACTOR);
  const auto sample_at = [&](Vec point, bool is_at_end) {
    const Mesh mesh = mesh_at(collider, is_at_end);
    const collide::Nearest hit = collide::nearest_on_mesh(mesh, 0, point, collide::INF);
    Sample sample = collide::sample_nearest(mesh, hit, point);
    sample.distance -= distance;
    return PatchHit{sample, hit.triangle};
  };
  const PatchHit hit = sample_at(to, true);
  if (!(hit.sample.distance < allowed_depth - collide::TOUCH_DISTANCE)) return false;
  MovingCapsule capsule = collider.capsule;
  store(surface_displacement(collider, hit, true, to), capsule.translation);
  Vec pushed = to, reference = from;
  if (!collide::push_out(capsule, {hit.sample.distance, hit.sample.normal},
                         sample_at(from, false).sample.distance, allowed_depth, from, pushed,
                         reference))
    return false;
  const Vec end_shift = (pushed - to) * (1 / total_weight),
            start_shift = (reference - from) * (1 / total_weight);
  for (std::size_t k = 0; k < 3; ++k) {
    const auto n = static_cast<std::size_t>(corners[k]);
    const double weight = network_.inverse_masses[n] * weights[k];
    double *p = &state.x[PARTICLE_STRIDE * n], *p_before = &state.before[PARTICLE_STRIDE * n];
    store(load(p) + end_shift * weight, p);
    store(load(p_before) + start_shift * weight, p_before);
    clearances_[n] -= weight * length(end_shift);
    if (particle_marks) (*particle_marks)[n] = 1;
  }
  return true;
}

double SpringContacts::depth(std::size_t c, std::size_t n) const {
  const std::size_t particles = network_.particle_count();
  if (n < particles) return colliders_.depth(c, n);
  const std::int32_t* ends = &network_.edges[2 * (n - particles)];
  const double min_depth = std::min(colliders_.depth(c, static_cast<std::size_t>(ends[0])),
                                    colliders_.depth(c, static_cast<std::size_t>(ends[1])));
  return min_depth - contact_distances_[c] * MIDPOINT_FACTOR;
}

bool SpringContacts::resolve_faces(StepState state, std::vector<std::uint8_t>* particle_marks) {
  bool has_moved = false;
  for (std::size_t c = 0; c < colliders_.size(); ++c) {
    if (!faces_.resolve(c, step_colliders_[c], h_, particles_near_colliders_, state)) continue;
    has_moved = true;
    for (const FaceContacts::MovedParticle& moved_particle : faces_.moved_particles) {
      const auto n = static_cast<std::size_t>(moved_particle.particle);
      clearances_[n] -= moved_particle.displacement;
      // Far corners of an edge or a face move too, and are not among the nearby particles.
      if (particle_marks) (*particle_marks)[n] = 1;
      record_impulse(c, 1 / network_.inverse_masses[n], load(&state.x[PARTICLE_STRIDE * n]),
                     moved_particle.velocity_change);
    }
  }
  return has_moved;
}

double SpringContacts::clearance(std::size_t n, Vec x) {
  double distance = collide::INF;
  for (std::size_t c = 0; c < collider_count_; ++c)
    distance = std::min(distance, query(c, n, true, x).sample.distance - depth(c, n));
  return distance;
}

void SpringContacts::update_clearance(std::size_t n, Vec x, double distance) {
  double lever_arm = 0;
  for (std::size_t c = 0; c < collider_count_; ++c)
    lever_arm = std::max(lever_arm, length(x - step_colliders_[c].end.origin));
  clearances_[n] = std::max(distance, 0.0);
  lever_arms_[n] = lever_arm + 2 * clearances_[n];
}

Mesh SpringContacts::mesh_at(const StepCollider& c, bool is_at_end) const {
  Mesh mesh = c.collider.mesh;
  if (!is_at_end) mesh.fraction = c.elapsed;
  return mesh;
}

SpringContacts::PatchHit SpringContacts::query(std::size_t index, std::size_t n, bool is_at_end,
                                               Vec point) {
  const StepCollider& c = step_colliders_[index];
  const double radius = colliders_.radius();
  if (!c.is_mesh())
    return {is_at_end ? c.sample_end(point, radius) : c.sample_start(point, radius), -1};
  const Mesh mesh = mesh_at(c, is_at_end);
  const Pose& pose = is_at_end ? c.end : c.begin;
  const double contact_distance = collide::contact_distance(c.collider, radius),
               side = c.collider.is_container ? -1 : 1;
  MeshMotion motion;
  KnotBoxes boxes{};
  if (c.surface >= 0) {
    const auto& surface = surfaces_[static_cast<std::size_t>(c.surface)];
    motion = surface.motion_until(mesh.fraction);
    boxes = surface.boxes(c.duration);
  }
  auto& patches = patches_[static_cast<std::size_t>(patch_indices_[index])];
  PatchHit hit =
      patches.query(mesh, c.collider.mesh_root, n, pose.to_local(point), motion,
                    motion.knot < 0 ? nullptr : &boxes, contact_distance, !c.collider.is_container);
  if (c.collider.is_two_sided) hit.sample = collide::unsigned_sample(hit.sample);
  const Vec out = pose.rotate(hit.sample.normal) * side;
  return {{side * hit.sample.distance - contact_distance, out}, hit.triangle};
}

Vec SpringContacts::surface_displacement(const StepCollider& c, const PatchHit& hit, bool is_at_end,
                                         Vec point) const {
  if (c.surface < 0) return c.collider.motion.displacement(point, is_at_end ? c.end : c.begin);
  if (hit.triangle < 0) return {};
  const auto& surface = surfaces_[static_cast<std::size_t>(c.surface)];
  return surface.surface_shift(mesh_at(c, is_at_end), hit.triangle, point) * c.duration;
}

void SpringContacts::record_impulse(std::size_t c, double mass, Vec point, Vec change) {
  if (c >= colliders_.size() || dot(change, change) == 0) return;
  const Vec impulse = change * -mass, moment = cross(point, impulse);
  double* row = interval_impulses_.data() + IMPULSE_WIDTH * c;
  const double values[IMPULSE_WIDTH - 1] = {impulse.x, impulse.y, impulse.z,
                                            moment.x,  moment.y,  moment.z};
  for (std::size_t k = 0; k < IMPULSE_WIDTH - 1; ++k) row[k] += values[k];
  masses_[c] += mass;
}

bool SpringContacts::resolve_particle(std::size_t n, double mass, double* before, double* x,
                                      double* v) {
  const Vec from = load(before);
  Vec to = load(x), reference = from;
  bool has_moved = false, is_pushed = true;
  // Solvers without velocities derive them from the displacement of the step.
  auto get_velocity = [&] { return v ? load(v) : (to - reference) * (1 / h_); };
  Vec last_velocity = get_velocity();
  auto record_change = [&](std::size_t c) {
    const Vec velocity = get_velocity();
    record_impulse(c, mass, to, velocity - last_velocity);
    last_velocity = velocity;
  };
  for (std::size_t c = 0; c < collider_count_; ++c) {
    has_moved |= sweep(c, n, from, to, v);
    record_change(c);
  }
  for (int i = 0; i < MAX_COLLIDER_ITERATIONS && is_pushed; ++i) {
    is_pushed = false;
    nearest_distance_ = collide::INF;
    for (std::size_t c = 0; c < collider_count_; ++c) {
      is_pushed |= push(c, n, from, to, reference, v);
      record_change(c);
    }
    has_moved |= is_pushed;
  }
  if (is_pushed) nearest_distance_ = clearance(n, to);
  update_clearance(n, to, nearest_distance_);
  if (has_moved) {
    store(to, x);
    store(reference, before);
  }
  return has_moved;
}

bool SpringContacts::sweep(std::size_t c, std::size_t n, Vec from, Vec& to, double* v) {
  if (step_colliders_[c].is_mesh()) return sweep_mesh(c, n, from, to, v);
  return step_colliders_[c].sweep(h_, colliders_.radius(), from, to, v);
}

bool SpringContacts::sweep_mesh(std::size_t index, std::size_t n, Vec from, Vec& to, double* v) {
  const StepCollider& c = step_colliders_[index];
  const double lever_arm = length(from - c.begin.origin);
  const double displacement =
      length(to - from) + c.max_displacement({}) + c.rotation_angle() * lever_arm;
  const double radius = colliders_.radius();
  if (!(displacement > c.thickness(radius))) return false;
  const PatchHit hit = query(index, n, false, from);
  // Particles that start inside are moved out at the depenetration speed.
  if (hit.sample.distance > displacement || hit.sample.distance < -collide::INSIDE_DEPTH)
    return false;
  const Vec surface_shift = surface_displacement(c, hit, false, from);
  if (!(length(to - from - surface_shift) > c.thickness(radius))) return false;
  if (c.surface < 0) return c.sweep(h_, radius, from, to, v);
  // In the frame of the nearest triangle; other triangles are as at the end of the step.
  const Vec start = from + surface_shift, velocity = (to - start) * (1 / h_);
  collide::Particle end{to, velocity};
  collide::ParticleContacts contacts(&c.collider, 1, h_, radius);
  if (contacts.resolve({start, velocity}, end).collider < 0) return false;
  to = end.position;
  if (v) store(end.velocity + surface_shift * (1 / h_), v);
  return true;
}

// Counts a particle that crossed a two-sided surface in a step as inside.
void SpringContacts::flip_if_crossed(const StepCollider& c, Vec from, Vec to, Sample& hit) const {
  const double clearance = collide::contact_distance(c.collider, colliders_.radius());
  const Vec before = c.begin.to_local(from), after = c.end.to_local(to);
  if (hit.distance + clearance > length(after - before)) return;
  if (!collide::changes_side(c.collider.mesh, c.collider.mesh_root, before, after)) return;
  hit = {-(hit.distance + clearance) - clearance, -hit.normal};
}

bool SpringContacts::push(std::size_t index, std::size_t n, Vec from, Vec& to, Vec& reference,
                          double* v) {
  const StepCollider& c = step_colliders_[index];
  const double allowed_depth = depth(index, n);
  PatchHit patch_hit = query(index, n, true, to);
  if (c.collider.is_two_sided) flip_if_crossed(c, from, to, patch_hit.sample);
  const Sample& hit = patch_hit.sample;
  nearest_distance_ = std::min(nearest_distance_, hit.distance - allowed_depth);
  if (!(hit.distance < allowed_depth - collide::TOUCH_DISTANCE)) return false;
  const Vec surface_shift = surface_displacement(c, patch_hit, true, to);
  if (v) {
    const Vec surface_velocity = surface_shift * (1 / h_),
              relative_velocity = load(v) - surface_velocity;
    const double normal_speed = dot(relative_velocity, hit.normal);
    if (normal_speed < 0) {
      const double restitution = c.collider.restitution;
      const double friction_speed = c.collider.friction * -normal_speed * (1 + restitution);
      Vec slip_velocity = relative_velocity - hit.normal * normal_speed;
      const double slip_speed = length(slip_velocity);
      slip_velocity =
          slip_velocity * (slip_speed > friction_speed ? 1 - friction_speed / slip_speed : 0.0);
      // The speed that gravity adds in a step is no impact: the particle rests.
      const double rebound_speed =
          -normal_speed > min_impact_speed_ ? restitution * normal_speed : 0.0;
      store(surface_velocity + slip_velocity - hit.normal * rebound_speed, v);
    }
  }
  const double start_distance = query(index, n, false, from).sample.distance;
  MovingCapsule capsule = c.capsule;
  if (c.surface >= 0) store(surface_shift, capsule.translation);
  return collide::push_out(capsule, {hit.distance, hit.normal}, start_distance, allowed_depth, from,
                           to, reference);
}

}  // namespace animtool
