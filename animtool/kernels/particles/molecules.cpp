// Molecules in a periodic box: neighbour lists and forces.
#include "particles/molecules.h"

#include <cmath>
#include <cstring>
#include <vector>

#include "base/checks.h"
#include "particles/molecules_lanes.h"
#include "particles/neighbours.h"
#include "particles/particles.h"

namespace animtool {

namespace {

// Checks that the box is at least twice as wide as a distance.
void check_box(const In<double, 1>& box, double max_distance) {
  check::shape("box", box, {3});
  for (std::size_t k = 0; k < 3; ++k) {
    check::positive("box", box.data()[k]);
    if (!(box.data()[k] >= 2 * max_distance))
      check::refuse("box", check::text(box.data()[k]) + " is not twice the distance at least");
  }
}

}  // namespace

std::tuple<Out<std::int32_t, 1>, Out<std::int64_t, 1>, Out<std::int32_t, 1>> molecule_pairs(
    In<double, 2> points, In<double, 1> box, double radius, std::int64_t max_pairs) {
  const std::size_t count = check::points("points", points);
  check::finite("points", points);
  check::positive("radius", radius);
  check::non_negative("max_pairs", static_cast<double>(max_pairs));
  check_box(box, radius);
  Out<std::int32_t, 1> order(count);
  Out<std::int64_t, 1> starts(count + 1);
  std::vector<std::int32_t> pair_partners;
  const double low[3] = {0, 0, 0};
  const Neighbours grid(points.data(), nullptr, count, radius, low, box.data());
  // In grid order, neighbours are near in memory too.
  const Block<std::int32_t> ranks = block<std::int32_t>(count);
  std::int32_t rank = 0;
  const auto assign_rank = [&](std::size_t, std::size_t molecule, const double*,
                               const std::int32_t*, const std::int32_t*) {
    order.get()[rank] = static_cast<std::int32_t>(molecule);
    ranks[molecule] = rank++;
  };
  grid.visit(points.data(), nullptr, count, HUGE_VAL, assign_rank);
  const std::int32_t padding = static_cast<std::int32_t>(count);
  std::size_t row = 0;
  bool is_within_limit = true;
  starts.get()[0] = 0;
  grid.visit(points.data(), nullptr, count, HUGE_VAL,
             [&](std::size_t, std::size_t, const double*, const std::int32_t* neighbour,
                 const std::int32_t* end) {
               const std::int32_t first = static_cast<std::int32_t>(row);
               is_within_limit =
                   is_within_limit && pair_partners.size() <= static_cast<std::size_t>(max_pairs);
               for (; neighbour < end && is_within_limit; ++neighbour) {
                 const std::int32_t second = ranks[grid.point_indices()[*neighbour]];
                 if (second > first) pair_partners.push_back(second);
               }
               while (pair_partners.size() % SIMD_WIDTH) pair_partners.push_back(padding);
               starts.get()[++row] = static_cast<std::int64_t>(pair_partners.size());
             });
  if (!is_within_limit)
    check::refuse("max_pairs", "there are more pairs than " + check::text(max_pairs));
  Out<std::int32_t, 1> partners(pair_partners.size());
  std::copy(pair_partners.begin(), pair_partners.end(), partners.get());
  return {std::move(order), std::move(starts), std::move(partners)};
}

std::tuple<Out<double, 2>, Out<double, 1>, double> molecule_forces(
    In<double, 2> points, In<std::int32_t, 1> order, In<std::int64_t, 1> starts,
    In<std::int32_t, 1> partners, In<double, 1> box, In<std::int32_t, 1> kinds,
    In<double, 3> forces, std::optional<In<double, 1>> charges, double cutoff, double onset,
    double damping) {
  const std::size_t count = check::points("points", points), kind_count = forces.shape(0);
  check::shape("order", order, {count});
  check::indices("order", order, 0, static_cast<std::int64_t>(count));
  check::shape("starts", starts, {count + 1});
  check::starts("starts", starts, partners.shape(0));
  for (std::size_t i = 0; i <= count; ++i)
    if (starts.data()[i] % static_cast<std::int64_t>(SIMD_WIDTH))
      check::refuse("starts", "index " + check::text(i) + " is not a multiple of four");
  check::indices("partners", partners, 0, static_cast<std::int64_t>(count) + 1);
  check::shape("kinds", kinds, {count});
  check::numbers("forces", forces, {kind_count, kind_count, 2});
  check::indices("kinds", kinds, 0, static_cast<std::int64_t>(kind_count));
  if (charges) {
    check::numbers("charges", *charges, {count});
  }
  check::positive("cutoff", cutoff);
  check::between("onset", onset, 0, cutoff);
  check::non_negative("damping", damping);
  check_box(box, cutoff);
  Out<double, 2> result(count, 3);
  Out<double, 1> energies(count);
  double virial = 0;
  const Block<double> rows = block<double>(4 * count + 4), out = block<double>(4 * count + 4);
  const Block<std::int32_t> sorted_kinds = block<std::int32_t>(count + 1);
  const Block<double> sorted_charges = block<double>(charges ? count + 1 : 0);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t molecule = static_cast<std::size_t>(order.data()[i]);
    for (std::size_t k = 0; k < 3; ++k) rows[4 * i + k] = points.data()[3 * molecule + k];
    rows[4 * i + 3] = 0;
    sorted_kinds[i] = kinds.data()[molecule];
    if (charges) sorted_charges[i] = charges->data()[molecule];
  }
  std::fill_n(rows.get() + 4 * count, 4, std::numeric_limits<double>::quiet_NaN());
  std::fill_n(out.get(), 4 * count + 4, 0.0);
  sorted_kinds[count] = 0;
  if (charges) sorted_charges[count] = 0;
  std::vector<MoleculeForce> pair_forces(kind_count * kind_count);
  for (std::size_t i = 0; i < pair_forces.size(); ++i)
    pair_forces[i] = {forces.data()[2 * i], forces.data()[2 * i + 1]};
  const MoleculeSystem system{count,
                              kind_count,
                              rows.get(),
                              starts.data(),
                              partners.data(),
                              sorted_kinds.get(),
                              pair_forces.data(),
                              charges ? sorted_charges.get() : nullptr,
                              {box.data()[0], box.data()[1], box.data()[2]},
                              cutoff * cutoff,
                              onset * onset,
                              damping};
  const MoleculeFunction quad_function = molecules_in_quads();
  if (count)
    virial =
        (quad_function ? quad_function : MoleculeKernels<Portable>::add_forces)(system, out.get());
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t molecule = static_cast<std::size_t>(order.data()[i]);
    for (std::size_t k = 0; k < 3; ++k) result.get()[3 * molecule + k] = out[4 * i + k];
    energies.get()[molecule] = out[4 * i + 3];
  }
  return {std::move(result), std::move(energies), virial};
}

}  // namespace animtool
