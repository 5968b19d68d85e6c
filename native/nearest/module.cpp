// The Python module tiegraph.features._nearest.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "nearest.h"

#include <stdexcept>
#include <string>

namespace nb = nanobind;
using namespace nb::literals;
using namespace nearest;

namespace {

using In = nb::ndarray<const u8, nb::shape<-1, LENGTH>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<nb::numpy, i32, nb::ndim<2>>;

// (3, count): index, best, second
Out found_of(std::size_t count, Found& found) {
  i32* data = new i32[3 * count];
  nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<i32*>(p); });
  found = {data, data + count, data + 2 * count};
  return Out(data, {3, count}, owner);
}

Descriptors descriptors_of(const In& a) {
  if (a.shape(0) > 10000000) throw std::invalid_argument("too many descriptors");
  return {a.data(), static_cast<int>(a.shape(0))};
}

const Kernel& kernel_of(const std::string& name) {
  int count;
  const Kernel* list = kernels(&count);
  if (name.empty()) return list[0];
  for (int k = 0; k < count; ++k) {
    if (name == list[k].name) return list[k];
  }
  throw std::invalid_argument("this machine runs no kernel " + name);
}

nb::tuple search(const In& a, const In& b, const std::string& kernel) {
  const Kernel& chosen = kernel_of(kernel);
  const Descriptors left = descriptors_of(a), right = descriptors_of(b);
  Found of_a, of_b;
  Out first = found_of(left.count, of_a), second = found_of(right.count, of_b);
  {
    nb::gil_scoped_release free;
    chosen.search(left, right, of_a, of_b);
  }
  return nb::make_tuple(first, second);
}

std::vector<std::string> names() {
  int count;
  const Kernel* list = kernels(&count);
  std::vector<std::string> out;
  for (int k = 0; k < count; ++k) out.emplace_back(list[k].name);
  return out;
}

}  // namespace

NB_MODULE(_nearest, m) {
  m.doc() = "Nearest descriptors of two images, both ways.";
  m.def("kernels", &names);
  m.def("search", &search, "a"_a, "b"_a, "kernel"_a = "");
}
