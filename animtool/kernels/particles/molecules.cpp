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

void check_box(const In<double, 1>& box, double reach) {
  check::shape("box", box, {3});
  for (std::size_t k = 0; k < 3; ++k) {
    check::positive("box", box.data()[k]);
    if (!(box.data()[k] >= 2 * reach))
      check::refuse("box", check::text(box.data()[k]) + " is not twice the reach at least");
  }
}

}  // namespace

std::tuple<Out<std::int32_t, 1>, Out<std::int64_t, 1>, Out<std::int32_t, 1>> molecule_pairs(
    In<double, 2> points, In<double, 1> box, double reach, std::int64_t max_pairs) {
  const std::size_t count = check::points("points", points);
  check::finite("points", points);
  check::positive("reach", reach);
  check::not_negative("max_pairs", static_cast<double>(max_pairs));
  check_box(box, reach);
  Out<std::int32_t, 1> order(count);
  Out<std::int64_t, 1> starts(count + 1);
  std::vector<std::int32_t> listed;
  const double low[3] = {0, 0, 0};
  const Neighbours grid(points.data(), nullptr, count, reach, low, box.data());
  // In grid order, neighbours are near in memory too.
  const Block<std::int32_t> ranks = block<std::int32_t>(count);
  std::int32_t rank = 0;
  const auto ranked = [&](std::size_t, std::size_t which, const double*, const std::int32_t*,
                          const std::int32_t*) {
    order.get()[rank] = static_cast<std::int32_t>(which);
    ranks[which] = rank++;
  };
  grid.visit(points.data(), nullptr, count, HUGE_VAL, ranked);
  const std::int32_t padding = static_cast<std::int32_t>(count);
  std::size_t row = 0;
  bool fits = true;
  starts.get()[0] = 0;
  grid.visit(points.data(), nullptr, count, HUGE_VAL,
             [&](std::size_t, std::size_t, const double*, const std::int32_t* hit,
                 const std::int32_t* end) {
               const std::int32_t self = static_cast<std::int32_t>(row);
               fits = fits && listed.size() <= static_cast<std::size_t>(max_pairs);
               for (; hit < end && fits; ++hit) {
                 const std::int32_t other = ranks[grid.index()[*hit]];
                 if (other > self) listed.push_back(other);
               }
               while (listed.size() % WIDE) listed.push_back(padding);
               starts.get()[++row] = static_cast<std::int64_t>(listed.size());
             });
  if (!fits) check::refuse("max_pairs", "there are more pairs than " + check::text(max_pairs));
  Out<std::int32_t, 1> partners(listed.size());
  std::copy(listed.begin(), listed.end(), partners.get());
  return {std::move(order), std::move(starts), std::move(partners)};
}

std::tuple<Out<double, 2>, Out<double, 1>, double> molecule_forces(
    In<double, 2> points, In<std::int32_t, 1> order, In<std::int64_t, 1> starts,
    In<std::int32_t, 1> partners, In<double, 1> box, In<std::int32_t, 1> kinds,
    In<double, 3> forces, std::optional<In<double, 1>> charges, double cutoff, double onset,
    double damping) {
  const std::size_t count = check::points("points", points), several = forces.shape(0);
  check::shape("order", order, {count});
  check::indices("order", order, 0, static_cast<std::int64_t>(count));
  check::shape("starts", starts, {count + 1});
  check::starts("starts", starts, partners.shape(0));
  for (std::size_t i = 0; i <= count; ++i)
    if (starts.data()[i] % static_cast<std::int64_t>(WIDE))
      check::refuse("starts", "index " + check::text(i) + " is not a multiple of four");
  check::indices("partners", partners, 0, static_cast<std::int64_t>(count) + 1);
  check::shape("kinds", kinds, {count});
  check::numbers("forces", forces, {several, several, 2});
  check::indices("kinds", kinds, 0, static_cast<std::int64_t>(several));
  if (charges) {
    check::numbers("charges", *charges, {count});
  }
  check::positive("cutoff", cutoff);
  check::between("onset", onset, 0, cutoff);
  check::not_negative("damping", damping);
  check_box(box, cutoff);
  Out<double, 2> result(count, 3);
  Out<double, 1> energies(count);
  double virial = 0;
  const Block<double> rows = block<double>(4 * count + 4), out = block<double>(4 * count + 4);
  const Block<std::int32_t> sorted = block<std::int32_t>(count + 1);
  const Block<double> charge = block<double>(charges ? count + 1 : 0);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t which = static_cast<std::size_t>(order.data()[i]);
    for (std::size_t k = 0; k < 3; ++k) rows[4 * i + k] = points.data()[3 * which + k];
    rows[4 * i + 3] = 0;
    sorted[i] = kinds.data()[which];
    if (charges) charge[i] = charges->data()[which];
  }
  std::fill_n(rows.get() + 4 * count, 4, std::numeric_limits<double>::quiet_NaN());
  std::fill_n(out.get(), 4 * count + 4, 0.0);
  sorted[count] = 0;
  if (charges) charge[count] = 0;
  std::vector<MoleculeForce> laws(several * several);
  for (std::size_t i = 0; i < laws.size(); ++i)
    laws[i] = {forces.data()[2 * i], forces.data()[2 * i + 1]};
  const MoleculeSystem system{count,
                              several,
                              rows.get(),
                              starts.data(),
                              partners.data(),
                              sorted.get(),
                              laws.data(),
                              charges ? charge.get() : nullptr,
                              {box.data()[0], box.data()[1], box.data()[2]},
                              cutoff * cutoff,
                              onset * onset,
                              damping};
  const MoleculeFunction quads = molecules_in_quads();
  if (count) virial = (quads ? quads : MoleculeLoops<Plain>::run)(system, out.get());
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t which = static_cast<std::size_t>(order.data()[i]);
    for (std::size_t k = 0; k < 3; ++k) result.get()[3 * which + k] = out[4 * i + k];
    energies.get()[which] = out[4 * i + 3];
  }
  return {std::move(result), std::move(energies), virial};
}

}  // namespace animtool
