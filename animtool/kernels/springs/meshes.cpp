// Mesh collisions of particles.
#include "springs/meshes.h"

#include <algorithm>

#include "base/checks.h"

namespace animtool {

using collide::load;
using collide::Mesh;
using collide::Nearest;
using collide::Vec;

double MeshPatches::displacement_since(const Patch& patch, Vec p, const MeshShift& motion,
                                       bool& in_knot) {
  const MeshShift& then = patch.motion;
  const double displacement =
      length(p - patch.at - (motion.drift - then.drift)) + std::abs(motion.spread - then.spread);
  in_knot = false;
  if (displacement <= patch.slack) return displacement;
  const double fraction = motion.fraction - then.fraction;
  if (motion.knot < 0 || motion.knot != then.knot || fraction < -patch.back) return -1;
  const double relative = length(p - patch.at - patch.shift * fraction);
  in_knot = relative <= patch.knot_slack;
  return in_knot ? relative : -1;
}

MeshPatches::PatchHit MeshPatches::query(const Mesh& mesh, std::int32_t root, std::size_t n, Vec p,
                                         const MeshShift& motion, const KnotBoxes* boxes,
                                         double contact_distance, bool bound) {
  Patch& patch = patches_[n];
  bool in_knot;
  const double displacement = displacement_since(patch, p, motion, in_knot);
  if (displacement < 0) {
    patch.at = p;
    patch.motion = motion;
    return gather(patch, mesh, root, p, boxes, contact_distance, bound);
  }
  if (patch.count == 0)
    return {{(in_knot ? patch.min_distance : patch.distance) - displacement, {0, 1, 0}}, -1};
  const Nearest best = nearest(patch, mesh, p, displacement);
  // So far away that the squared distance overflows.
  if (best.triangle < 0) return {{collide::FAR, {0, 1, 0}}, -1};
  return {collide::sample_nearest(mesh, best, p), best.triangle};
}

Nearest MeshPatches::nearest(const Patch& patch, const Mesh& mesh, Vec p,
                             double displacement) const {
  Nearest best;
  const Candidates& candidates = candidates_[static_cast<std::size_t>(patch.location)];
  double max_useful_distance = collide::FAR;
  for (int k = 0; k < patch.count && candidates[k].distance <= max_useful_distance; ++k) {
    const Nearest hit = collide::nearest_of_triangle(mesh, candidates[k].triangle, p);
    if (!collide::nearer(hit, best)) continue;
    best = hit;
    max_useful_distance = std::sqrt(best.squared) + displacement + collide::TOUCH;
  }
  return best;
}

void MeshPatches::invalidate() {
  for (Patch& patch : patches_) patch.slack = patch.knot_slack = -1;
}

MeshPatches::PatchHit MeshPatches::gather(Patch& patch, const Mesh& mesh, std::int32_t root, Vec p,
                                          const KnotBoxes* boxes, double contact_distance,
                                          bool bound) {
  patch.count = 0;
  patch.slack = patch.knot_slack = -1;
  if (bound) {
    patch.distance = std::sqrt(collide::squared_to_box(p, mesh.bounds + 6 * root));
    const double slack = (patch.distance - contact_distance) / 2;
    if (slack > patch.next_slack) {
      patch.slack = slack;
      return {{patch.distance, {0, 1, 0}}, -1};
    }
  }
  const Nearest near = search(patch, mesh, root, p, boxes, bound ? contact_distance : collide::FAR);
  if (near.triangle < 0) return {{collide::FAR, {0, 1, 0}}, -1};
  const collide::Sample hit = collide::sample_nearest(mesh, near, p);
  // Inside, far triangles matter as well.
  if (bound && hit.distance < 0) search(patch, mesh, root, p, boxes, collide::FAR);
  patch.distance = std::sqrt(near.squared);
  patch.last = last_ = near.triangle;
  const double excess = hit.distance - contact_distance,
               min_distance = min_distance_ - contact_distance, reach = 2 * patch.next_slack;
  if (bound && excess > reach) {
    // Far away: a bound suffices, in the interval or while particle and mesh move alike.
    patch.slack = excess / 2;
    patch.min_distance = min_distance_;
    if (boxes && min_distance > 0) patch.knot_slack = min_distance / 2;
  } else if (boxes && store_candidates(patch, patch.distance + reach, true)) {
    patch.slack = patch.knot_slack = patch.next_slack;
  } else if (store_candidates(patch, patch.distance + reach, false)) {
    patch.slack = patch.next_slack;
  } else {
    patch.next_slack /= 2;
    return {hit, near.triangle};
  }
  if (4 * patch.count < MAX_CANDIDATES && patch.count > 0) patch.next_slack *= 1.5;
  return {hit, near.triangle};
}

Nearest MeshPatches::search(Patch& patch, const Mesh& mesh, std::int32_t root, Vec p,
                            const KnotBoxes* boxes, double contact_distance) {
  nearby_.clear();
  Nearest best;
  double farthest = collide::FAR;
  const auto update_reach = [&] {
    // Far away, the nearest triangle and close alternatives suffice.
    const double distance = std::sqrt(best.squared), more = 2 * patch.next_slack;
    const double reach = distance > contact_distance + more
                             ? std::max(distance, contact_distance + 2 * more)
                             : distance + more;
    farthest = reach * reach;
  };
  // Consecutive particles are close to each other.
  if (patch.last < 0) patch.last = last_;
  if (patch.last < 0) patch.last = collide::nearest_on_mesh(mesh, root, p, collide::FAR).triangle;
  if (patch.last < 0) return best;
  best = collide::nearest_of_triangle(mesh, patch.last, p);
  update_reach();
  const double fraction = mesh.fraction, remaining = 1 - fraction;
  patch.shift = {};
  if (boxes) {
    const std::int32_t* corner = mesh.triangles + 3 * patch.last;
    for (int k = 0; k < 3; ++k)
      patch.shift = patch.shift + load(mesh.shifts + 3 * corner[k]) * (1.0 / 3);
  }
  const double shift[3] = {patch.shift.x, patch.shift.y, patch.shift.z};
  patch.back = boxes ? boxes->back : 0;
  // Over the rest of the interval, relative to the nearest triangle.
  const auto squared = [&](std::int32_t node) {
    if (!boxes) return collide::squared_to_box(p, mesh.bounds + 6 * node);
    const double *at = boxes->begins + 6 * node, *go = boxes->shifts + 6 * node;
    double box[6];
    for (int k = 0; k < 3; ++k) {
      const double low = go[k] - shift[k], high = go[3 + k] - shift[k];
      box[k] = at[k] + fraction * go[k] + std::min({0.0, remaining * low, -patch.back * high});
      box[3 + k] =
          at[3 + k] + fraction * go[3 + k] + std::max({0.0, remaining * high, -patch.back * low});
    }
    return collide::squared_to_box(p, box);
  };
  const double span = std::max(remaining, patch.back);
  collide::visit_boxes(mesh, root, farthest, squared, [&](std::int32_t t) {
    const Nearest hit = collide::nearest_of_triangle(mesh, t, p);
    if (collide::nearer(hit, best)) {
      best = hit;
      update_reach();
    }
    const double distance = std::sqrt(hit.squared);
    double over = 0;
    if (boxes) {
      const std::int32_t* corner = mesh.triangles + 3 * t;
      for (int k = 0; k < 3; ++k)
        over = std::max(over, length(load(mesh.shifts + 3 * corner[k]) - patch.shift));
    }
    nearby_.push_back({distance, distance - span * over, t});
    return farthest;
  });
  min_distance_ = std::sqrt(farthest);
  for (const NearbyTriangle& one : nearby_)
    min_distance_ = std::min(min_distance_, one.min_distance);
  return best;
}

bool MeshPatches::store_candidates(Patch& patch, double reach, bool in_knot) {
  if (patch.location < 0) {
    patch.location = static_cast<std::int32_t>(candidates_.size());
    candidates_.emplace_back();
  }
  Candidates& candidates = candidates_[static_cast<std::size_t>(patch.location)];
  int count = 0;
  for (const NearbyTriangle& one : nearby_) {
    const double distance = in_knot ? one.min_distance : one.distance;
    if (!(distance <= reach)) continue;
    if (count == MAX_CANDIDATES) return false;
    candidates[count++] = {distance, one.triangle};
  }
  std::sort(candidates.begin(), candidates.begin() + count,
            [](const Candidate& a, const Candidate& b) {
              if (a.distance != b.distance) return a.distance < b.distance;
              return a.triangle < b.triangle;
            });
  patch.count = count;
  return true;
}

// Largest number of cells per knot interval.
constexpr std::int64_t MAX_LASTING = std::int64_t{1} << 40;

MovingSurface::MovingSurface(const SpringSurface& surface, std::int64_t cells)
    : surface_(std::get<0>(surface)),
      points_(std::get<1>(surface)),
      numbers_(std::get<2>(surface)),
      cells_per_knot_(std::get<3>(surface)),
      first_(std::get<4>(surface)) {
  if (!surface_) check::refuse("colliders.surfaces", "a surface is None");
  check::between("colliders.surfaces", cells_per_knot_, 1, MAX_LASTING);
  check::between("colliders.surfaces", first_, 0, cells_per_knot_ - 1);
  const std::int64_t knots = (first_ + cells + cells_per_knot_ - 1) / cells_per_knot_ + 1;
  check::numbers("colliders.surfaces", points_,
                 {static_cast<std::size_t>(knots), surface_->points(), 3});
  check::finite("colliders.surfaces", numbers_.data(), numbers_.size());
  shifts_.resize(3 * surface_->points());
  surface_->fit(points_.data(), points_.data(), bounds_);
  if (bounds_.empty()) check::refuse("colliders.surfaces", "a surface has no triangle");
}

bool MovingSurface::begin_cell(std::int64_t cell, double length) {
  const std::int64_t knot = (first_ + cell) / cells_per_knot_,
                     over = (first_ + cell) % cells_per_knot_;
  knot_start_ = static_cast<double>(over) / static_cast<double>(cells_per_knot_);
  if (begin_ && knot == last_) return true;
  const bool is_next = begin_ && knot == last_ + 1, begins = !begin_;
  if (is_next) {
    before_.drift = before_.drift + full_.drift;
    before_.spread += full_.spread;
  }
  last_ = knot;
  const std::size_t row = shifts_.size();
  const double* begin = points_.data() + static_cast<std::size_t>(knot) * row;
  const double* end = begin + row;
  const bool stays = is_next && travel_ == 0 && std::equal(begin, end, end);
  begin_ = begin;
  if (stays) return true;
  measure(begin, end);
  const bool teleports = travel_ > numbers_[4] * length * static_cast<double>(cells_per_knot_);
  if (teleports) {
    // A teleported mesh is at its goal from the start of the cell.
    begin_ = end;
    measure(end, end);
  }
  surface_->fit(begin_, end, bounds_);
  if (travel_ > 0) {
    surface_->fit(begin_, begin_, begins_);
    surface_->fit(shifts_.data(), shifts_.data(), shift_bounds_);
  }
  return (begins || is_next) && !teleports;
}

void MovingSurface::measure(const double* begin, const double* end) {
  const std::size_t count = shifts_.size() / 3;
  Vec sum;
  travel_ = 0;
  for (std::size_t p = 0; p < 3 * count; p += 3) {
    const Vec shift = load(end + p) - load(begin + p);
    store(shift, shifts_.data() + p);
    sum = sum + shift;
    travel_ = std::max(travel_, length(shift));
  }
  full_.drift = sum * (1 / static_cast<double>(count));
  full_.spread = 0;
  for (std::size_t p = 0; travel_ > 0 && p < 3 * count; p += 3)
    full_.spread = std::max(full_.spread, length(load(shifts_.data() + p) - full_.drift));
}

double MovingSurface::relative_travel(Vec drift, double fraction) const {
  double most = 0;
  for (std::size_t p = 0; p < shifts_.size(); p += 3)
    most = std::max(most, length(load(shifts_.data() + p) * fraction - drift));
  return most;
}

collide::Collider MovingSurface::collider(double fraction) const {
  collide::Collider built;
  built.shape = collide::Shape::MESH;
  built.mesh = surface_->mesh(begin_, shifts_.data(), bounds_.data());
  built.mesh.fraction = fraction;
  built.restitution = numbers_[0], built.friction = numbers_[1];
  built.margin = numbers_[2], built.depenetration = numbers_[3];
  return built;
}

MeshShift MovingSurface::shift_until(double fraction) const {
  return {before_.drift + full_.drift * fraction, before_.spread + full_.spread * fraction,
          travel_ > 0 ? last_ : -1, fraction};
}

Vec MovingSurface::shift(const Mesh& mesh, std::int32_t triangle, Vec p) const {
  const std::int32_t* corner = mesh.triangles + 3 * triangle;
  const collide::Barycentric at = collide::barycentric_of_nearest(
      p, mesh.point(corner[0]), mesh.point(corner[1]), mesh.point(corner[2]));
  const Vec a = load(&shifts_[3 * corner[0]]), b = load(&shifts_[3 * corner[1]]),
            c = load(&shifts_[3 * corner[2]]);
  return a + (b - a) * at.b + (c - a) * at.c;
}

}  // namespace animtool
