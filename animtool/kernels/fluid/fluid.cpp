// Steps of a fluid, and its density.
#include "fluid/fluid.h"

#include <algorithm>
#include <array>

#include "base/checks.h"
#include "fluid/film.h"
#include "fluid/lanes.h"
#include "fluid/steps.h"
#include "particles/neighbours.h"
#include "springs/contacts.h"

namespace animtool {

namespace fluid {

using collide::Collider;
using collide::load;
using collide::Pose;
using collide::Sample;
using collide::Shape;
using collide::store;

namespace {

// Four numbers of a particle: a vector and a scalar.
struct alignas(32) ParticleRow {
  double x = 0, y = 0, z = 0, w = 0;

  Vec vector() const { return {x, y, z}; }
};

// A body that the fluid pushes, with its displacement from free motion.
struct Body {
  double inverse_mass = 0;         // 1 over its mass
  double inverse_inertia[6];       // its inverse inertia: xx, yy, zz, xy, xz, yz
  Vec begin, end;                  // centre of mass at the start and the end of the step
  Vec shift, rotation;             // displacement from free motion so far
  Vec velocity, angular_velocity;  // changes of these by the fluid
  double impulse[6] = {},
         impulse_times_remaining_time[6] = {};  // impulses and angular impulses about the origin;
                                                // the same times the remaining time

  Vec angular_change(Vec angular_impulse) const {
    return {inverse_inertia[0] * angular_impulse.x + inverse_inertia[3] * angular_impulse.y +
                inverse_inertia[4] * angular_impulse.z,
            inverse_inertia[3] * angular_impulse.x + inverse_inertia[1] * angular_impulse.y +
                inverse_inertia[5] * angular_impulse.z,
            inverse_inertia[4] * angular_impulse.x + inverse_inertia[5] * angular_impulse.y +
                inverse_inertia[2] * angular_impulse.z};
  }
};

// Displaces the pose of a collider with its body.
Pose displace_pose(const Pose& pose, const Body& body, Vec centre) {
  Pose result = pose;
  const double angle = length(body.rotation);
  if (angle > 0) {
    const double vector[3] = {body.rotation.x, body.rotation.y, body.rotation.z};
    double quaternion[4];
    Pose change;
    ik::exponential(vector, quaternion);
    ik::normalize(quaternion);
    ik::to_matrix(quaternion, change.rotation);
    result.origin = centre + change.rotate(pose.origin - centre);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        result.rotation[3 * i + j] = 0;
        for (int k = 0; k < 3; ++k)
          result.rotation[3 * i + j] += change.rotation[3 * i + k] * pose.rotation[3 * k + j];
      }
  }
  result.origin = result.origin + body.shift;
  return result;
}

// Constants of a fluid.
struct FluidConstants {
  double spacing, density, viscosity, tension;
  double radius() const { return RADIUS_RATIO * spacing; }
  double mass() const { return density * spacing * spacing * spacing; }
};

// Advances a fluid by substeps.
class FluidStepper {
 public:
  FluidStepper(const FluidConstants& constants, std::vector<Collider> colliders,
               std::vector<std::int32_t> owners, std::vector<Body> bodies, double step,
               double sound_speed)
      : constants_(constants),
        sound_speed_(sound_speed),
        colliders_(std::move(colliders)),
        body_of_collider_(std::move(owners)),
        bodies_(std::move(bodies)),
        step_(step),
        radius_(constants.radius()),
        lattice_weight_sum_(Walls::lattice_weight_sum()) {}

  // Sets the state of the particles.
  void reset(const double* state, const double* accelerations, std::size_t count) {
    count_ = count;
    const std::size_t rows = count + 1;
    order_.assign(rows, static_cast<std::int32_t>(count));
    points_.assign(rows, {PADDING_POSITION, PADDING_POSITION, PADDING_POSITION, 0});
    points_before_ = points_;
    velocities_.assign(rows, {}), accelerations_.assign(rows, {}), pressures_.assign(rows, 0);
    for (std::size_t i = 0; i < count; ++i) {
      order_[i] = static_cast<std::int32_t>(i);
      const double *x = state + 3 * i, *v = state + 3 * (count + i), *a = accelerations + 3 * i;
      points_[i] = {x[0], x[1], x[2], 0};
      velocities_[i] = {v[0], v[1], v[2], 0};
      accelerations_[i] = {a[0], a[1], a[2], 0};
    }
    poses_.resize(colliders_.size());
    old_poses_.resize(colliders_.size());
    pose_colliders(0, poses_);
  }

  // Advances by a number of substeps.
  void run(std::size_t substeps) {
    const double h = step_ / static_cast<double>(substeps);
    // Short substeps are as stiff as long ones, up to the stability limit.
    const double fraction = std::min(sound_speed_ * h / constants_.spacing, 1.0);
    relaxation_ = RELAXATION * fraction * fraction;
    for (std::size_t k = 0; k < substeps; ++k) {
      const double end_fraction = static_cast<double>(k + 1) / static_cast<double>(substeps);
      predict(h);
      old_poses_ = poses_;
      pose_colliders(end_fraction, poses_);
      if (!has_lists_ || is_list_stale()) build_lists();
      measure_density();
      apply_tension(h, k, substeps);
      apply_pressure(h);
      resolve_contacts(h);
      apply_damping(h, k, substeps);
      push_bodies(h, 1 - end_fraction);
    }
    for (double& pressure : pressures_) pressure /= static_cast<double>(substeps);
  }

  // Stores the state and the mean pressures in the original order.
  void store_state(double* state, double* pressure) const {
    for (std::size_t i = 0; i < count_; ++i) {
      const std::size_t row = static_cast<std::size_t>(order_[i]);
      store(points_[i].vector(), state + 3 * row);
      store(velocities_[i].vector(), state + 3 * (count_ + row));
      pressure[row] = pressures_[i];
    }
  }

  // Densities over the rest density, without motion.
  void densities(double* out) {
    points_before_ = points_;
    build_lists();
    measure_density();
    for (std::size_t i = 0; i < count_; ++i) out[order_[i]] = 1 + excess_densities_[i];
  }

  const std::vector<Body>& bodies() const { return bodies_; }
  double compression() const { return compression_; }

 private:
  struct ColliderContact {
    std::int32_t collider;
    WallContribution contribution;
    Vec correction = {};  // displacement, and later the velocity change by it
    Vec point = {};
  };

  // Advances particles by their accelerations and velocities.
  void predict(double h) {
    for (std::size_t i = 0; i < count_; ++i) {
      ParticleRow& x = points_[i];
      ParticleRow& v = velocities_[i];
      const ParticleRow& a = accelerations_[i];
      points_before_[i] = x;
      v.x += h * a.x, v.y += h * a.y, v.z += h * a.z;
      x.x += h * v.x, x.y += h * v.y, x.z += h * v.z;
    }
  }

  void pose_colliders(double fraction, std::vector<Pose>& poses) const {
    for (std::size_t c = 0; c < colliders_.size(); ++c) {
      poses[c] = colliders_[c].motion.pose_at(fraction);
      if (body_of_collider_[c] < 0) continue;
      const Body& body = bodies_[static_cast<std::size_t>(body_of_collider_[c])];
      poses[c] = displace_pose(poses[c], body, body.begin + (body.end - body.begin) * fraction);
    }
  }

  // Whether particles or colliders may be near each other that are not in the lists.
  bool is_list_stale() const {
    double max_squared = 0;
    for (std::size_t i = 0; i < count_; ++i) {
      const double x = points_[i].x - listed_points_[i].x, y = points_[i].y - listed_points_[i].y,
                   z = points_[i].z - listed_points_[i].z;
      max_squared = std::max(max_squared, x * x + y * y + z * z);
    }
    const double margin = LIST_MARGIN_RATIO * radius_, max_shift = std::sqrt(max_squared);
    if (!(2 * max_shift <= margin)) return true;
    for (std::size_t c = 0; c < colliders_.size(); ++c) {
      const Pose &listed_pose = listed_poses_[c], &pose = poses_[c];
      double rotation = 0;
      for (int k = 0; k < 9; ++k) rotation += std::fabs(pose.rotation[k] - listed_pose.rotation[k]);
      const double distance = length(pose.origin - particles_centre_) + particles_extent_;
      if (!(max_shift + length(pose.origin - listed_pose.origin) + rotation * distance <= margin))
        return true;
    }
    return false;
  }

  // Reorders values.
  template <class T>
  void reorder(std::vector<T>& values, const std::vector<std::int32_t>& order) {
    std::vector<T> sorted_values(values.size());
    for (std::size_t i = 0; i < order.size(); ++i)
      sorted_values[i] = values[static_cast<std::size_t>(order[i])];
    values.swap(sorted_values);
  }

  // Sorts particles by grid cells, and lists neighbours and colliders until the lists are stale.
  void build_lists() {
    std::vector<double> points(3 * count_);
    for (std::size_t i = 0; i < count_; ++i) store(points_[i].vector(), &points[3 * i]);
    const double no_period[3] = {0, 0, 0};
    const Neighbours grid(points.data(), nullptr, count_, radius_ * (1 + LIST_MARGIN_RATIO),
                          no_period, no_period);
    std::vector<std::int32_t> order(grid.point_indices(), grid.point_indices() + grid.size());
    // Non-finite particles have no neighbours, and are last.
    if (order.size() < count_) {
      std::vector<bool> has_cell(count_);
      for (const std::int32_t i : order) has_cell[static_cast<std::size_t>(i)] = true;
      for (std::size_t i = 0; i < count_; ++i)
        if (!has_cell[i]) order.push_back(static_cast<std::int32_t>(i));
    }
    order.push_back(static_cast<std::int32_t>(count_));
    reorder(order_, order), reorder(points_, order), reorder(points_before_, order),
        reorder(velocities_, order);
    reorder(accelerations_, order), reorder(pressures_, order);
    neighbour_starts_.assign(count_ + 1, 0);
    partners_.clear();
    grid.visit_all<true>(
        std::numeric_limits<double>::infinity(),
        [&](std::size_t i, const double*, const std::int32_t* partner, const std::int32_t* end) {
          partners_.insert(partners_.end(), partner, end);
          while (partners_.size() % SIMD_WIDTH) partners_.push_back(order.back());
          neighbour_starts_[i + 1] = partners_.size();
        });
    for (std::size_t i = grid.size(); i < count_; ++i) neighbour_starts_[i + 1] = partners_.size();
    factors_.resize(partners_.size());
    listed_points_ = points_;
    listed_poses_ = poses_;
    has_lists_ = true;
    list_colliders();
    if (constants_.tension > 0) free_surface_.list_blocks(&points_.data()->x, count_);
    excess_densities_.resize(count_), virial_.resize(count_);
  }

  void list_colliders() {
    Vec low{}, high{};
    for (std::size_t i = 0; i < count_; ++i) {
      const ParticleRow& x = points_[i];
      if (!i) low = high = x.vector();
      low = {std::min(low.x, x.x), std::min(low.y, x.y), std::min(low.z, x.z)};
      high = {std::max(high.x, x.x), std::max(high.y, x.y), std::max(high.z, x.z)};
    }
    particles_centre_ = (low + high) * 0.5;
    particles_extent_ = length(high - low) / 2 + radius_;
    contacts_.clear();
    contact_starts_.assign(count_ + 1, 0);
    const double max_distance = radius_ * (1 + LIST_MARGIN_RATIO);
    std::vector<std::size_t> near_colliders;
    for (std::size_t c = 0; c < colliders_.size(); ++c)
      if (collide::sample(colliders_[c], poses_[c], particles_centre_, 0,
                          particles_extent_ + max_distance)
              .distance < particles_extent_ + max_distance)
        near_colliders.push_back(c);
    for (std::size_t i = 0; i < count_; ++i) {
      for (const std::size_t c : near_colliders)
        if (collide::sample(colliders_[c], poses_[c], points_[i].vector(), 0, max_distance)
                .distance < max_distance)
          contacts_.push_back({static_cast<std::int32_t>(c), {}});
      contact_starts_[i + 1] = contacts_.size();
    }
  }

  FluidPairs pairs() {
    const double inverse_radius = 1 / radius_;
    // Second derivative factor of the weight, over the distance.
    const double derivative_scale = -3 * inverse_radius * inverse_radius / lattice_weight_sum_;
    return {count_,
            neighbour_starts_.data(),
            partners_.data(),
            &points_.data()->x,
            &velocities_.data()->x,
            factors_.data(),
            &density_gradients_.data()->x,
            &corrections_.data()->x,
            squared_gradients_.data(),
            inverse_radius,
            derivative_scale,
            0,
            0};
  }

  // Computes the density of each particle, its gradient, and the pressure multiplier.
  void measure_density() {
    density_gradients_.assign(count_ + 1, {}), corrections_.assign(count_ + 1, {}),
        squared_gradients_.assign(count_ + 1, 0);
    functions_.measure_density(pairs());
    const double scale = 1 / lattice_weight_sum_,
                 min_steepness = Walls::lattice_steepness() / (radius_ * radius_);
    const double wall_virial = Walls::virial();
    double sum = 0;
    for (std::size_t i = 0; i < count_; ++i) {
      ParticleRow gradient = density_gradients_[i];
      const double neighbour_excess = (1 + gradient.w) * scale - 1;
      gradient.w = squared_gradients_[i];
      const double wall_contribution_sum = measure_colliders(i, scale, gradient),
                   density_excess = neighbour_excess + wall_contribution_sum;
      excess_densities_[i] = density_excess;
      const double compression = std::max(density_excess, 0.0);
      sum += compression;
      const double steepness =
          gradient.x * gradient.x + gradient.y * gradient.y + gradient.z * gradient.z + gradient.w;
      points_[i].w = compression > 0 ? -relaxation_ * compression /
                                           std::max(GRADIENT_DAMPING * steepness, min_steepness)
                                     : 0.0;
      // A wall presses as the lattice layers would that it replaces.
      virial_[i] = -wall_virial * wall_contribution_sum * points_[i].w;
    }
    compression_ = count_ ? sum / static_cast<double>(count_) : 0.0;
  }

  // Applies surface tension. One evaluation covers as many substeps as the shortest ripples allow.
  void apply_tension(double h, std::size_t substep, std::size_t substeps) {
    if (!(constants_.tension > 0)) return;
    const double period = std::sqrt(constants_.mass() / constants_.tension);
    const double max_substeps =
        std::min(MAX_CAPILLARY_TIME * period / h, static_cast<double>(substeps));
    const std::size_t combined_substeps =
        std::max<std::size_t>(static_cast<std::size_t>(max_substeps), 1);
    if (substep % combined_substeps != 0) return;
    const double duration =
        h * static_cast<double>(std::min(combined_substeps, substeps - substep));
    free_surface_.compute_area(&points_.data()->x, count_);
    free_surface_.add_tension(&points_.data()->x, count_,
                              -constants_.tension * h * duration / constants_.mass(),
                              &corrections_.data()->x);
  }

  // Damps velocities before the next neighbour update: together with pressure this would overshoot.
  void apply_damping(double h, std::size_t substep, std::size_t substeps) {
    std::fill(corrections_.begin(), corrections_.end(), ParticleRow());
    const bool has_viscosity = apply_viscosity(h, substep, substeps),
               has_noise_damping = damp_noise(h, substep, substeps);
    if (!has_viscosity && !has_noise_damping) return;
    for (std::size_t i = 0; i < count_; ++i) {
      velocities_[i].x += corrections_[i].x, velocities_[i].y += corrections_[i].y;
      velocities_[i].z += corrections_[i].z;
    }
  }

  // Applies viscosity; returns whether it did. One evaluation covers as many substeps as are stable
  // together.
  bool apply_viscosity(double h, std::size_t substep, std::size_t substeps) {
    const double max_substeps =
        MAX_VISCOUS_TIME * constants_.spacing * constants_.spacing / (constants_.viscosity * h);
    const std::size_t combined_substeps =
        max_substeps < static_cast<double>(substeps)
            ? std::max<std::size_t>(static_cast<std::size_t>(max_substeps), 1)
            : substeps;
    if (!(constants_.viscosity > 0) || substep % combined_substeps != 0) return false;
    FluidPairs damped_pairs = pairs();
    damped_pairs.damping = -2 * constants_.viscosity * h *
                           static_cast<double>(std::min(combined_substeps, substeps - substep));
    functions_.apply_viscosity(damped_pairs);
    return true;
  }

  // Damps the noise of particles, in every few substeps; returns whether it did.
  bool damp_noise(double h, std::size_t substep, std::size_t substeps) {
    // Not what viscosity removes itself. Drops that tension pulls together would solidify.
    if (constants_.tension > 0) return false;
    const double strength =
        1 - constants_.viscosity / (NOISE_VISCOSITY * sound_speed_ * constants_.spacing);
    if (substep % NOISE_SUBSTEPS != 0 || !(strength > 0)) return false;
    const double fraction = std::min(sound_speed_ * h / constants_.spacing, 1.0);
    FluidPairs damped_pairs = pairs();
    damped_pairs.noise_speed = NOISE_SPEED * sound_speed_;
    damped_pairs.damping = -NOISE_DECAY * strength * fraction *
                           static_cast<double>(std::min(NOISE_SUBSTEPS, substeps - substep));
    functions_.damp_noise(damped_pairs);
    return true;
  }

  // Adds the contribution of colliders to a particle's density gradient; returns that to its
  // density.
  double measure_colliders(std::size_t i, double scale, ParticleRow& gradient) {
    const std::size_t first = contact_starts_[i], last = contact_starts_[i + 1];
    if (first == last) return 0;
    double open_fraction = 1;
    for (std::size_t k = first; k < last; ++k) {
      const std::size_t c = static_cast<std::size_t>(contacts_[k].collider);
      contacts_[k].contribution =
          wall_contribution(colliders_[c], poses_[c], points_[i].vector(), radius_);
      open_fraction *= 1 - contacts_[k].contribution.fraction;
    }
    const double full_density = walls().full_density() * scale;
    for (std::size_t k = first; k < last; ++k) {
      double unfilled_density = full_density;
      for (std::size_t m = first; m < last; ++m)
        if (m != k) unfilled_density *= 1 - contacts_[m].contribution.fraction;
      Vec& wall_gradient = contacts_[k].contribution.gradient;
      wall_gradient = wall_gradient * unfilled_density;
      contacts_[k].contribution.pressing_gradient =
          contacts_[k].contribution.pressing_gradient * unfilled_density;
      gradient.x += wall_gradient.x, gradient.y += wall_gradient.y, gradient.z += wall_gradient.z;
      gradient.w += dot(wall_gradient, wall_gradient);
    }
    return full_density * (1 - open_fraction);
  }

  // Moves dense particles apart.
  void apply_pressure(double h) {
    functions_.apply_pressure(pairs());
    const double pressure_scale = constants_.density / (h * h);
    for (std::size_t i = 0; i < count_; ++i) {
      pressures_[i] += (virial_[i] + corrections_[i].w) * pressure_scale;
      Vec position = points_[i].vector() + corrections_[i].vector();
      for (std::size_t k = contact_starts_[i]; k < contact_starts_[i + 1]; ++k) {
        // The wall presses as the fluid in front of it does.
        const Vec wall_push = contacts_[k].contribution.pressing_gradient * points_[i].w;
        contacts_[k].correction = wall_push;
        position = position + wall_push;
      }
      points_[i].x = position.x, points_[i].y = position.y, points_[i].z = position.z;
    }
  }

  // Displacement of a point of a collider in the substep.
  Vec surface_displacement(std::size_t c, Vec point) const {
    return point - old_poses_[c].to_world(poses_[c].to_local(point));
  }

  // Number of walls of a container's corner.
  static constexpr int MAX_WALLS = 3;
  // Two colliders push a particle into each other: at most this many iterations, and no further
  // than this fraction of half a spacing.
  static constexpr int MAX_ALTERNATIONS = 16;
  static constexpr double CONTACT_TOLERANCE = 1e-4;

  // Pushes particles out of colliders, and updates their velocities.
  void resolve_contacts(double h) {
    const double inverse_h = 1 / h, particle_radius = constants_.spacing / 2;
    for (std::size_t i = 0; i < count_; ++i) {
      Vec x = points_[i].vector();
      Vec v = (x - points_before_[i].vector()) * inverse_h;
      int touch_count = 0;
      for (std::size_t k = contact_starts_[i]; k < contact_starts_[i + 1]; ++k) {
        ColliderContact& contact = contacts_[k];
        const Vec impulse = contact.correction * inverse_h, old_velocity = v;
        touch_count += resolve_contact(contact, points_before_[i].vector(), inverse_h,
                                       length(impulse), x, v) > 0;
        contact.correction = impulse + (v - old_velocity);
      }
      for (int iteration = 0; iteration < MAX_ALTERNATIONS && touch_count > 1; ++iteration) {
        double max_depth = 0;
        for (std::size_t k = contact_starts_[i]; k < contact_starts_[i + 1]; ++k) {
          const Vec old_velocity = v;
          max_depth = std::max(max_depth, resolve_contact(contacts_[k], points_before_[i].vector(),
                                                          inverse_h, 0, x, v));
          contacts_[k].correction = contacts_[k].correction + (v - old_velocity);
        }
        if (max_depth <= CONTACT_TOLERANCE * particle_radius) break;
      }
      points_[i].x = x.x, points_[i].y = x.y, points_[i].z = x.z;
      velocities_[i] = {v.x, v.y, v.z, 0};
    }
  }

  // Pushes a particle out of a collider, with friction for an impulse; returns the penetration
  // depth.
  double resolve_contact(ColliderContact& contact, Vec before, double inverse_h,
                         double normal_impulse, Vec& x, Vec& v) {
    const double particle_radius = constants_.spacing / 2;
    const std::size_t c = static_cast<std::size_t>(contact.collider);
    const Collider& collider = colliders_[c];
    double max_depth = 0;
    // The walls of a container's corner are resolved one after another.
    for (int wall = 0; wall < MAX_WALLS; ++wall) {
      const Vec from = poses_[c].to_local(before);
      const Sample sample = collide::sample_after_crossing(collider, from, poses_[c], x,
                                                           particle_radius, particle_radius);
      if (!wall) contact.point = x - sample.normal * (sample.distance + particle_radius);
      const bool is_touching = sample.distance < 0;
      if (!is_touching && (wall || !(collider.friction > 0 && normal_impulse > 0))) break;
      max_depth = std::max(max_depth, -sample.distance);
      const Vec surface_velocity = surface_displacement(c, x) * inverse_h;
      const double normal_velocity = dot(v - surface_velocity, sample.normal);
      if (is_touching) {
        x = x - sample.normal * sample.distance;
        if (normal_velocity < 0) {
          v = v - sample.normal * ((1 + collider.restitution) * normal_velocity);
          normal_impulse -= normal_velocity;
        }
      }
      if (collider.friction > 0 && normal_impulse > 0) {
        const Vec relative_velocity = v - surface_velocity;
        const Vec slip = relative_velocity - sample.normal * dot(relative_velocity, sample.normal);
        const double speed = length(slip), friction_limit = collider.friction * normal_impulse;
        v = v - slip * (speed > friction_limit ? friction_limit / speed : 1.0);
        normal_impulse = 0;
      }
      if (!is_touching || collider.shape != Shape::BOX || !collider.is_container) break;
    }
    return max_depth;
  }

  // Applies the opposite impulses of particles to bodies.
  void push_bodies(double h, double remaining_fraction) {
    if (bodies_.empty()) return;
    const double fraction = 1 - remaining_fraction;
    std::vector<Vec> impulses(bodies_.size()), angular_impulses(bodies_.size());
    const double mass = constants_.mass();
    for (const ColliderContact& contact : contacts_) {
      const std::int32_t owner = body_of_collider_[static_cast<std::size_t>(contact.collider)];
      if (owner < 0) continue;
      const std::size_t b = static_cast<std::size_t>(owner);
      const Vec impulse = contact.correction * -mass;
      impulses[b] = impulses[b] + impulse;
      angular_impulses[b] = angular_impulses[b] + cross(contact.point, impulse);
    }
    for (std::size_t b = 0; b < bodies_.size(); ++b) {
      Body& body = bodies_[b];
      const double wrench[6] = {impulses[b].x,         impulses[b].y,
                                impulses[b].z,         angular_impulses[b].x,
                                angular_impulses[b].y, angular_impulses[b].z};
      for (int k = 0; k < 6; ++k)
        body.impulse[k] += wrench[k],
            body.impulse_times_remaining_time[k] += wrench[k] * remaining_fraction * step_;
      const Vec centre = body.begin + (body.end - body.begin) * fraction + body.shift;
      body.velocity = body.velocity + impulses[b] * body.inverse_mass;
      body.angular_velocity = body.angular_velocity +
                              body.angular_change(angular_impulses[b] - cross(centre, impulses[b]));
      body.shift = body.shift + body.velocity * h;
      body.rotation = body.rotation + body.angular_velocity * h;
    }
  }

  // Position of the padding particle of neighbour lists.
  static constexpr double PADDING_POSITION = 1e30;
  // Largest time of one viscosity evaluation, over squared spacing / viscosity.
  static constexpr double MAX_VISCOUS_TIME = 0.1;
  // Largest time of one tension evaluation, over the square root of mass / tension.
  static constexpr double MAX_CAPILLARY_TIME = 0.5;

  const FluidFunctions& functions_ =
      fluid_in_quads() ? *fluid_in_quads() : FluidKernels<Portable>::functions;
  const FluidConstants constants_;
  const double sound_speed_;
  double relaxation_ = 0;
  const std::vector<Collider> colliders_;
  const std::vector<std::int32_t> body_of_collider_;
  std::vector<Body> bodies_;
  const double step_, radius_, lattice_weight_sum_;
  std::size_t count_ = 0;
  bool has_lists_ = false;
  double compression_ = 0, particles_extent_ = 0;
  FreeSurface free_surface_{constants_.spacing};
  Vec particles_centre_;
  // In grid order; `order_` is the original index of each particle.
  std::vector<std::int32_t> order_, partners_;
  std::vector<std::size_t> neighbour_starts_, contact_starts_;
  std::vector<double> factors_, squared_gradients_, excess_densities_, pressures_, virial_;
  std::vector<ParticleRow> points_, points_before_, velocities_, accelerations_, corrections_,
      density_gradients_, listed_points_;
  std::vector<ColliderContact> contacts_;
  std::vector<Pose> poses_, old_poses_, listed_poses_;
};

}  // namespace

}  // namespace fluid

namespace {

fluid::FluidConstants read_constants(double spacing, double density, double viscosity,
                                     double tension) {
  check::positive("spacing", spacing);
  check::positive("density", density);
  check::non_negative("viscosity", viscosity);
  check::non_negative("tension", tension);
  return {spacing, density, viscosity, tension};
}

}  // namespace

FluidStepResult fluid_steps(ColliderArrays colliders, In<std::int32_t, 1> owners,
                            In<double, 2> bodies, In<double, 3> state, In<double, 2> accelerations,
                            double spacing, double density, double viscosity, double tension,
                            double sound_speed, double step, std::int64_t substeps) {
  const std::size_t count = state.shape(1), body_count = bodies.shape(0);
  std::vector<collide::Collider> shapes = read_colliders(colliders);
  check::shape("owners", owners, {shapes.size()});
  check::shape("bodies", bodies, {body_count, 13});
  check::indices("owners", owners, -1, static_cast<std::int64_t>(body_count));
  check::finite("bodies", bodies);
  check::shape("state", state, {2, check::ANY, 3});
  check::shape("accelerations", accelerations, {count, 3});
  check::at_most("state", count, check::MAX_ROWS);
  check::positive("sound_speed", sound_speed);
  check::positive("step", step);
  check::between("substeps", substeps, 1, 1 << 24);
  const fluid::FluidConstants constants = read_constants(spacing, density, viscosity, tension);
  std::vector<fluid::Body> fluid_bodies(body_count);
  for (std::size_t b = 0; b < body_count; ++b) {
    const double* row = bodies.data() + 13 * b;
    fluid_bodies[b].inverse_mass = row[0];
    std::copy_n(row + 1, 6, fluid_bodies[b].inverse_inertia);
    fluid_bodies[b].begin = collide::load(row + 7), fluid_bodies[b].end = collide::load(row + 10);
  }
  Out<double, 3> result(2, count, 3), wrenches(2, body_count, 6);
  Out<double, 1> pressures(count);
  double compression = 0;
  fluid::FluidStepper stepper(constants, std::move(shapes),
                              {owners.data(), owners.data() + owners.size()},
                              std::move(fluid_bodies), step, sound_speed);
  stepper.reset(state.data(), accelerations.data(), count);
  stepper.run(static_cast<std::size_t>(substeps));
  stepper.store_state(result.get(), pressures.get());
  compression = stepper.compression();
  for (std::size_t b = 0; b < body_count; ++b) {
    std::copy_n(stepper.bodies()[b].impulse, 6, wrenches.get() + 6 * b);
    std::copy_n(stepper.bodies()[b].impulse_times_remaining_time, 6,
                wrenches.get() + 6 * (body_count + b));
  }
  return {std::move(result), std::move(pressures), std::move(wrenches), compression};
}

Out<double, 1> fluid_densities(ColliderArrays colliders, In<double, 2> points, double spacing) {
  const std::size_t count = points.shape(0);
  std::vector<collide::Collider> shapes = read_colliders(colliders);
  check::shape("points", points, {check::ANY, 3});
  check::at_most("points", count, check::MAX_ROWS);
  const fluid::FluidConstants constants = read_constants(spacing, 1, 0, 0);
  Out<double, 1> result(count);
  const std::vector<std::int32_t> owners(shapes.size(), -1);
  fluid::FluidStepper stepper(constants, std::move(shapes), owners, {}, 1, 1);
  std::vector<double> state(6 * count, 0.0), zero_accelerations(3 * count, 0.0);
  std::copy_n(points.data(), 3 * count, state.data());
  stepper.reset(state.data(), zero_accelerations.data(), count);
  stepper.densities(result.get());
  return result;
}

double fluid_area(In<double, 2> points, double spacing) {
  const std::size_t count = points.shape(0);
  check::shape("points", points, {check::ANY, 3});
  check::at_most("points", count, check::MAX_ROWS);
  check::positive("spacing", spacing);
  std::vector<double> rows(4 * count);
  for (std::size_t i = 0; i < count; ++i) std::copy_n(points.data() + 3 * i, 3, &rows[4 * i]);
  fluid::FreeSurface free_surface(spacing);
  free_surface.list_blocks(rows.data(), count);
  return free_surface.compute_area(rows.data(), count);
}

}  // namespace animtool
