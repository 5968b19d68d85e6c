// The Python module tiegraph.dense._sgm.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "match.h"
#include "pyramid.h"

#include <algorithm>
#include <optional>

namespace nb = nanobind;
using namespace nb::literals;
using namespace sgm;

namespace {

template <class T>
using In = nb::ndarray<const T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
template <class T>
using Out = nb::ndarray<nb::numpy, T, nb::ndim<2>>;

template <class T>
Out<T> new_array(std::size_t rows, std::size_t columns, T** data) {
  *data = new T[rows * columns];
  nb::capsule owner(*data, [](void* p) noexcept { delete[] static_cast<T*>(p); });
  return Out<T>(*data, {rows, columns}, owner);
}

Image image_of(const In<u8>& a) {
  if (a.shape(0) > 1000000 || a.shape(1) > 1000000) throw std::invalid_argument("image too large");
  return {a.data(), static_cast<int>(a.shape(1)), static_cast<int>(a.shape(0))};
}

nb::tuple run(const In<u8>& left, const In<u8>& right, const Ranges& ranges, const Options& options,
              Workspace& workspace, const std::optional<In<u8>>& mutual) {
  if (mutual && (mutual->shape(0) != 256 || mutual->shape(1) != 256)) {
    throw std::invalid_argument("the table of mutual information is 256 x 256");
  }
  float* disparity;
  u16* score;
  auto found = new_array<float>(left.shape(0), left.shape(1), &disparity);
  auto costs = new_array<u16>(left.shape(0), left.shape(1), &score);
  {
    nb::gil_scoped_release free;
    match(image_of(left), image_of(right), ranges, mutual ? mutual->data() : nullptr, options, workspace, disparity,
          score);
  }
  return nb::make_tuple(found, costs);
}

Ranges ranges_of(const In<u8>& left, const In<i16>& first, const In<u8>& blocks) {
  for (int k = 0; k < 2; ++k) {
    if (first.shape(k) != left.shape(k) || blocks.shape(k) != left.shape(k)) {
      throw std::invalid_argument("ranges must have the shape of the left image");
    }
  }
  Ranges r;
  r.first = first.data();
  r.blocks = blocks.data();
  return r;
}

Ranges dense_range(int low, int count) {
  Ranges r;
  r.low = low;
  r.count = count;
  return r;
}

Out<u8> half(const In<u8>& image) {
  u8* data;
  auto out = new_array<u8>((image.shape(0) + 1) / 2, (image.shape(1) + 1) / 2, &data);
  nb::gil_scoped_release free;
  halve(image_of(image), data);
  return out;
}

nb::tuple ranges(const In<float>& coarse, int width, int height, const RangeRules& rules) {
  if (static_cast<int>(coarse.shape(0)) != (height + 1) / 2 || static_cast<int>(coarse.shape(1)) != (width + 1) / 2) {
    throw std::invalid_argument("the coarser level has half the size, rounded up");
  }
  i16* first;
  u8* blocks;
  auto firsts = new_array<i16>(height, width, &first);
  auto counts = new_array<u8>(height, width, &blocks);
  u64 cells;
  {
    nb::gil_scoped_release free;
    cells = find_ranges(coarse.data(), width, height, rules, first, blocks);
  }
  return nb::make_tuple(firsts, counts, cells);
}

Out<u32> joint_greys(const In<u8>& left, const In<u8>& right, const In<float>& disparity) {
  if (left.shape(0) != right.shape(0) || disparity.shape(0) != left.shape(0) || disparity.shape(1) != left.shape(1)) {
    throw std::invalid_argument("images of the same height and a disparity for each pixel of the left one");
  }
  u32* counts;
  auto out = new_array<u32>(256, 256, &counts);
  nb::gil_scoped_release free;
  std::fill(counts, counts + 256 * 256, 0);
  count_greys(image_of(left), image_of(right), disparity.data(), counts);
  return out;
}

std::vector<std::string> kernel_names() {
  int n = 0;
  const Kernel* list = kernels(&n);
  std::vector<std::string> names;
  for (int i = 0; i < n; ++i) names.emplace_back(list[i].name);
  return names;
}

}  // namespace

NB_MODULE(_sgm, m) {
  m.doc() = "Semi-global matching of rectified pairs, dense or with a range for each pixel.";
  nb::class_<Options>(m, "Options")
      .def(nb::init<>())
      .def_rw("radius_x", &Options::radius_x)
      .def_rw("radius_y", &Options::radius_y)
      .def_rw("small", &Options::small)
      .def_rw("large", &Options::large)
      .def_rw("large_by_step", &Options::large_by_step)
      .def_rw("uniqueness", &Options::uniqueness)
      .def_rw("left_right", &Options::left_right)
      .def_rw("parabola", &Options::parabola)
      .def_rw("mode", &Options::mode)
      .def_rw("threads", &Options::threads)
      .def_rw("kernel", &Options::kernel);
  nb::class_<Workspace>(m, "Workspace")
      .def(nb::init<>())
      .def("release", &Workspace::release)
      .def_prop_ro("bytes", &Workspace::bytes);
  nb::class_<RangeRules>(m, "RangeRules")
      .def(nb::init<>())
      .def_rw("low", &RangeRules::low)
      .def_rw("count", &RangeRules::count)
      .def_rw("reach", &RangeRules::reach)
      .def_rw("margin", &RangeRules::margin)
      .def_rw("hole_limit", &RangeRules::hole_limit);
  m.def("halve", &half, "image"_a.noconvert(), "Means of 2 x 2 pixels.");
  m.def("ranges", &ranges, "coarse"_a.noconvert(), "width"_a, "height"_a, "rules"_a,
        "First disparity and blocks of 16 of each pixel, and their number in all.");
  m.def("joint_greys", &joint_greys, "left"_a.noconvert(), "right"_a.noconvert(), "disparity"_a.noconvert(),
        "How often (256, 256) a left and a right grey value lie upon each other.");
  m.def("kernels", &kernel_names, "Names of the kernels this machine can run, best first.");
  m.def(
      "match_dense",
      [](const In<u8>& left, const In<u8>& right, int low, int count, const Options& options, Workspace& workspace,
         const std::optional<In<u8>>& mutual) {
        return run(left, right, dense_range(low, count), options, workspace, mutual);
      },
      "left"_a.noconvert(), "right"_a.noconvert(), "low"_a, "count"_a, "options"_a, "workspace"_a, "mutual"_a.noconvert() = nb::none());
  m.def(
      "match_ragged",
      [](const In<u8>& left, const In<u8>& right, const In<i16>& first, const In<u8>& blocks, const Options& options,
         Workspace& workspace, const std::optional<In<u8>>& mutual) {
        return run(left, right, ranges_of(left, first, blocks), options, workspace, mutual);
      },
      "left"_a.noconvert(), "right"_a.noconvert(), "first"_a.noconvert(), "blocks"_a.noconvert(), "options"_a, "workspace"_a, "mutual"_a.noconvert() = nb::none());
}
