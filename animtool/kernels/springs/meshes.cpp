// Collisions of particles with meshes.
#include "springs/meshes.h"

#include <algorithm>

#include "base/checks.h"

namespace animtool {

using collide::load;
using collide::Mesh;
using collide::Nearest;
using collide::Vec;

double MeshPatches::displacement_since(const Patch& patch, Vec p, const MeshMotion& motion,
                                       bool& is_in_knot) {
  const MeshMotion& patch_motion = patch.motion;
  const double displacement = length(p - patch.position - (motion.drift - patch_motion.drift)) +
                              std::abs(motion.spread - patch_motion.spread);
  is_in_knot = false;
  if (displacement <= patch.slack) return displacement;
  const double fraction = motion.fraction - patch_motion.fraction;
  if (motion.knot < 0 || motion.knot != patch_motion.knot || fraction < -patch.lookback) return -1;
  const double relative_displacement = length(p - patch.position - patch.triangle_shift * fraction);
  is_in_knot = relative_displacement <= patch.knot_slack;
  return is_in_knot ? relative_displacement : -1;
}

MeshPatches::PatchHit MeshPatches::query(const Mesh& mesh, std::int32_t root, std::size_t n, Vec p,
                                         const MeshMotion& motion, const KnotBoxes* boxes,
                                         double contact_distance, bool allows_bound) {
  Patch& patch = patches_[n];
  bool is_in_knot;
  const double displacement = displacement_since(patch, p, motion, is_in_knot);
  if (displacement < 0) {
    patch.position = p;
    patch.motion = motion;
    return fill_cache(patch, mesh, root, p, boxes, contact_distance, allows_bound);
  }
  if (patch.count == 0)
    return {{(is_in_knot ? patch.min_distance : patch.distance) - displacement, {0, 1, 0}}, -1};
  const Nearest best_hit = nearest(patch, mesh, p, displacement);
  // So far away that the squared distance overflows.
  if (best_hit.triangle < 0) return {{collide::INF, {0, 1, 0}}, -1};
  return {collide::sample_nearest(mesh, best_hit, p), best_hit.triangle};
}

Nearest MeshPatches::nearest(const Patch& patch, const Mesh& mesh, Vec p,
                             double displacement) const {
  Nearest best_hit;
  const Candidates& candidates = candidates_[static_cast<std::size_t>(patch.candidates_index)];
  double max_useful_distance = collide::INF;
  for (int k = 0; k < patch.count && candidates[k].distance <= max_useful_distance; ++k) {
    const Nearest hit = collide::nearest_of_triangle(mesh, candidates[k].triangle, p);
    if (!collide::is_nearer(hit, best_hit)) continue;
    best_hit = hit;
    max_useful_distance =
        std::sqrt(best_hit.squared_distance) + displacement + collide::TOUCH_DISTANCE;
  }
  return best_hit;
}

void MeshPatches::invalidate() {
  for (Patch& patch : patches_) patch.slack = patch.knot_slack = -1;
}

MeshPatches::PatchHit MeshPatches::fill_cache(Patch& patch, const Mesh& mesh, std::int32_t root,
                                              Vec p, const KnotBoxes* boxes,
                                              double contact_distance, bool allows_bound) {
  patch.count = 0;
  patch.slack = patch.knot_slack = -1;
  if (allows_bound) {
    patch.distance = std::sqrt(collide::squared_box_distance(p, mesh.bounds + 6 * root));
    const double slack = (patch.distance - contact_distance) / 2;
    if (slack > patch.next_slack) {
      patch.slack = slack;
      return {{patch.distance, {0, 1, 0}}, -1};
    }
  }
  const Nearest nearest =
      search(patch, mesh, root, p, boxes, allows_bound ? contact_distance : collide::INF);
  if (nearest.triangle < 0) return {{collide::INF, {0, 1, 0}}, -1};
  const collide::Sample hit = collide::sample_nearest(mesh, nearest, p);
  // Inside, distant triangles matter as well.
  if (allows_bound && hit.distance < 0) search(patch, mesh, root, p, boxes, collide::INF);
  patch.distance = std::sqrt(nearest.squared_distance);
  patch.seed_triangle = last_triangle_ = nearest.triangle;
  const double excess = hit.distance - contact_distance,
               min_distance = min_distance_ - contact_distance, margin = 2 * patch.next_slack;
  if (allows_bound && excess > margin) {
    // Far away a bound is enough, over the knot interval or while particle and mesh move alike.
    patch.slack = excess / 2;
    patch.min_distance = min_distance_;
    if (boxes && min_distance > 0) patch.knot_slack = min_distance / 2;
  } else if (boxes && store_candidates(patch, patch.distance + margin, true)) {
    patch.slack = patch.knot_slack = patch.next_slack;
  } else if (store_candidates(patch, patch.distance + margin, false)) {
    patch.slack = patch.next_slack;
  } else {
    patch.next_slack /= 2;
    return {hit, nearest.triangle};
  }
  if (4 * patch.count < MAX_CANDIDATES && patch.count > 0) patch.next_slack *= 1.5;
  return {hit, nearest.triangle};
}

Nearest MeshPatches::search(Patch& patch, const Mesh& mesh, std::int32_t root, Vec p,
                            const KnotBoxes* boxes, double contact_distance) {
  nearby_triangles_.clear();
  Nearest best_hit;
  double squared_limit = collide::INF;
  const auto update_limit = [&] {
    // Far away, the nearest triangle and close alternatives are enough.
    const double distance = std::sqrt(best_hit.squared_distance), margin = 2 * patch.next_slack;
    const double limit = distance > contact_distance + margin
                             ? std::max(distance, contact_distance + 2 * margin)
                             : distance + margin;
    squared_limit = limit * limit;
  };
  // Consecutive particles are close to each other.
  if (patch.seed_triangle < 0) patch.seed_triangle = last_triangle_;
  if (patch.seed_triangle < 0)
    patch.seed_triangle = collide::nearest_on_mesh(mesh, root, p, collide::INF).triangle;
  if (patch.seed_triangle < 0) return best_hit;
  best_hit = collide::nearest_of_triangle(mesh, patch.seed_triangle, p);
  update_limit();
  const double fraction = mesh.fraction, remaining_fraction = 1 - fraction;
  patch.triangle_shift = {};
  if (boxes) {
    const std::int32_t* corner = mesh.triangles + 3 * patch.seed_triangle;
    for (int k = 0; k < 3; ++k)
      patch.triangle_shift =
          patch.triangle_shift + load(mesh.displacements + 3 * corner[k]) * (1.0 / 3);
  }
  const double triangle_shift[3] = {patch.triangle_shift.x, patch.triangle_shift.y,
                                    patch.triangle_shift.z};
  patch.lookback = boxes ? boxes->lookback : 0;
  // Squared distance of a node's box over the remaining interval, relative to the nearest triangle.
  const auto squared_distance = [&](std::int32_t node) {
    if (!boxes) return collide::squared_box_distance(p, mesh.bounds + 6 * node);
    const double *start_box = boxes->start_bounds + 6 * node,
                 *shift_box = boxes->shift_bounds + 6 * node;
    double box[6];
    for (int k = 0; k < 3; ++k) {
      const double low = shift_box[k] - triangle_shift[k],
                   high = shift_box[3 + k] - triangle_shift[k];
      box[k] = start_box[k] + fraction * shift_box[k] +
               std::min({0.0, remaining_fraction * low, -patch.lookback * high});
      box[3 + k] = start_box[3 + k] + fraction * shift_box[3 + k] +
                   std::max({0.0, remaining_fraction * high, -patch.lookback * low});
    }
    return collide::squared_box_distance(p, box);
  };
  const double max_fraction = std::max(remaining_fraction, patch.lookback);
  collide::visit_boxes(mesh, root, squared_limit, squared_distance, [&](std::int32_t t) {
    const Nearest hit = collide::nearest_of_triangle(mesh, t, p);
    if (collide::is_nearer(hit, best_hit)) {
      best_hit = hit;
      update_limit();
    }
    const double distance = std::sqrt(hit.squared_distance);
    double relative_shift = 0;
    if (boxes) {
      const std::int32_t* corner = mesh.triangles + 3 * t;
      for (int k = 0; k < 3; ++k)
        relative_shift = std::max(relative_shift, length(load(mesh.displacements + 3 * corner[k]) -
                                                         patch.triangle_shift));
    }
    nearby_triangles_.push_back({distance, distance - max_fraction * relative_shift, t});
    return squared_limit;
  });
  min_distance_ = std::sqrt(squared_limit);
  for (const NearbyTriangle& triangle : nearby_triangles_)
    min_distance_ = std::min(min_distance_, triangle.min_distance);
  return best_hit;
}

bool MeshPatches::store_candidates(Patch& patch, double max_distance, bool is_in_knot) {
  if (patch.candidates_index < 0) {
    patch.candidates_index = static_cast<std::int32_t>(candidates_.size());
    candidates_.emplace_back();
  }
  Candidates& candidates = candidates_[static_cast<std::size_t>(patch.candidates_index)];
  int count = 0;
  for (const NearbyTriangle& nearby : nearby_triangles_) {
    const double distance = is_in_knot ? nearby.min_distance : nearby.distance;
    if (!(distance <= max_distance)) continue;
    if (count == MAX_CANDIDATES) return false;
    candidates[count++] = {distance, nearby.triangle};
  }
  std::sort(candidates.begin(), candidates.begin() + count,
            [](const Candidate& a, const Candidate& b) {
              if (a.distance != b.distance) return a.distance < b.distance;
              return a.triangle < b.triangle;
            });
  patch.count = count;
  return true;
}

// Largest number of time intervals per knot interval.
constexpr std::int64_t MAX_INTERVALS_PER_KNOT = std::int64_t{1} << 40;

MovingSurface::MovingSurface(const SpringSurface& surface, std::int64_t interval_count)
    : surface_(std::get<0>(surface)),
      points_(std::get<1>(surface)),
      settings_(std::get<2>(surface)),
      intervals_per_knot_(std::get<3>(surface)),
      first_interval_(std::get<4>(surface)) {
  if (!surface_) check::refuse("colliders.surfaces", "a surface is None");
  check::between("colliders.surfaces", intervals_per_knot_, 1, MAX_INTERVALS_PER_KNOT);
  check::between("colliders.surfaces", first_interval_, 0, intervals_per_knot_ - 1);
  const std::int64_t knot_count =
      (first_interval_ + interval_count + intervals_per_knot_ - 1) / intervals_per_knot_ + 1;
  check::numbers("colliders.surfaces", points_,
                 {static_cast<std::size_t>(knot_count), surface_->point_count(), 3});
  check::finite("colliders.surfaces", settings_.data(), settings_.size());
  shifts_.resize(3 * surface_->point_count());
  surface_->fit_boxes(points_.data(), points_.data(), bounds_);
  if (bounds_.empty()) check::refuse("colliders.surfaces", "a surface has no triangle");
}

void MovingSurface::find_fine_points(double max_radius, double max_size) {
  is_fine_.clear();
  const double* last_points = points_.data() + points_.size() - shifts_.size();
  for (const double radius : surface_->curvature_radii(last_points))
    is_fine_.push_back(radius < max_radius);
  const Mesh mesh = surface_->mesh(points_.data(), nullptr, bounds_.data());
  // Children follow their parents.
  const std::size_t node_count = bounds_.size() / 6;
  std::vector<std::uint8_t> has_fine(node_count, 0), is_covered(node_count, 0);
  for (std::size_t node = node_count; node-- > 0;) {
    const std::int32_t left = mesh.nodes[2 * node], right = mesh.nodes[2 * node + 1];
    if (left >= 0)
      has_fine[node] =
          has_fine[static_cast<std::size_t>(left)] | has_fine[static_cast<std::size_t>(right)];
    else
      for (std::int32_t c = 3 * (-1 - left); c < 3 * (-1 - left + right); ++c)
        has_fine[node] |= is_fine_[static_cast<std::size_t>(mesh.triangles[c])];
  }
  for (std::size_t node = 0; node < node_count; ++node) {
    const double* box = bounds_.data() + 6 * node;
    const bool is_leaf = mesh.nodes[2 * node] < 0;
    const bool is_small = is_leaf || !(length(load(box + 3) - load(box)) > max_size);
    if (has_fine[node] && is_small && !is_covered[node])
      fine_nodes_.push_back(static_cast<std::int32_t>(node));
    if (is_leaf) continue;
    for (const int side : {0, 1})
      is_covered[static_cast<std::size_t>(mesh.nodes[2 * node + side])] =
          is_covered[node] || is_small;
  }
}

std::int32_t MovingSurface::point_below(std::int32_t node) const {
  const Mesh mesh = surface_->mesh(points_.data(), nullptr, bounds_.data());
  while (mesh.nodes[2 * node] >= 0) node = mesh.nodes[2 * node];
  return mesh.triangles[3 * (-1 - mesh.nodes[2 * node])];
}

bool MovingSurface::begin_interval(std::int64_t interval, double duration) {
  const std::int64_t knot = (first_interval_ + interval) / intervals_per_knot_,
                     elapsed_intervals = (first_interval_ + interval) % intervals_per_knot_;
  knot_start_fraction_ =
      static_cast<double>(elapsed_intervals) / static_cast<double>(intervals_per_knot_);
  if (knot_points_ && knot == knot_) return true;
  const bool is_next = knot_points_ && knot == knot_ + 1, is_first = !knot_points_;
  if (is_next) {
    past_motion_.drift = past_motion_.drift + knot_motion_.drift;
    past_motion_.spread += knot_motion_.spread;
  }
  knot_ = knot;
  const std::size_t row = shifts_.size();
  const double* begin = points_.data() + static_cast<std::size_t>(knot) * row;
  const double* end = begin + row;
  const bool is_static = is_next && max_displacement_ == 0 && std::equal(begin, end, end);
  knot_points_ = begin;
  if (is_static) return true;
  measure_motion(begin, end);
  const bool has_teleported =
      max_displacement_ > settings_[4] * duration * static_cast<double>(intervals_per_knot_);
  if (has_teleported) {
    // A teleported mesh is at its end position from the start of the interval.
    knot_points_ = end;
    measure_motion(end, end);
  }
  surface_->fit_boxes(knot_points_, end, bounds_);
  if (max_displacement_ > 0) {
    surface_->fit_boxes(knot_points_, knot_points_, start_bounds_);
    surface_->fit_boxes(shifts_.data(), shifts_.data(), shift_bounds_);
  }
  return (is_first || is_next) && !has_teleported;
}

void MovingSurface::measure_motion(const double* begin, const double* end) {
  const std::size_t count = shifts_.size() / 3;
  Vec sum;
  max_displacement_ = 0;
  for (std::size_t p = 0; p < 3 * count; p += 3) {
    const Vec shift = load(end + p) - load(begin + p);
    store(shift, shifts_.data() + p);
    sum = sum + shift;
    max_displacement_ = std::max(max_displacement_, length(shift));
  }
  knot_motion_.drift = sum * (1 / static_cast<double>(count));
  knot_motion_.spread = 0;
  for (std::size_t p = 0; max_displacement_ > 0 && p < 3 * count; p += 3)
    knot_motion_.spread =
        std::max(knot_motion_.spread, length(load(shifts_.data() + p) - knot_motion_.drift));
}

double MovingSurface::max_relative_displacement(Vec drift, double fraction) const {
  double largest = 0;
  for (std::size_t p = 0; p < shifts_.size(); p += 3)
    largest = std::max(largest, length(load(shifts_.data() + p) * fraction - drift));
  return largest;
}

collide::Collider MovingSurface::collider(double fraction) const {
  collide::Collider result;
  result.shape = collide::Shape::MESH;
  result.mesh = surface_->mesh(knot_points_, shifts_.data(), bounds_.data());
  result.mesh.fraction = fraction;
  result.restitution = settings_[0], result.friction = settings_[1];
  result.margin = settings_[2], result.depenetration = settings_[3];
  return result;
}

MeshMotion MovingSurface::motion_until(double fraction) const {
  return {past_motion_.drift + knot_motion_.drift * fraction,
          past_motion_.spread + knot_motion_.spread * fraction, max_displacement_ > 0 ? knot_ : -1,
          fraction};
}

Vec MovingSurface::surface_shift(const Mesh& mesh, std::int32_t triangle, Vec p) const {
  const std::int32_t* corner = mesh.triangles + 3 * triangle;
  const collide::Barycentric coordinates = collide::barycentric_of_nearest(
      p, mesh.point(corner[0]), mesh.point(corner[1]), mesh.point(corner[2]));
  const Vec a = load(&shifts_[3 * corner[0]]), b = load(&shifts_[3 * corner[1]]),
            c = load(&shifts_[3 * corner[2]]);
  return a + (b - a) * coordinates.b + (c - a) * coordinates.c;
}

}  // namespace animtool
