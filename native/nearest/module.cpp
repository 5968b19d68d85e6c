// The Python module tiegraph.features._nearest.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "nearest.h"

#include <algorithm>
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

int count_of(const In& a) {
  if (a.shape(0) > 10000000) throw std::invalid_argument("too many descriptors");
  return static_cast<int>(a.shape(0));
}

// The first kernel of this name, or the fastest one, for so many descriptors.
const Kernel& kernel_of(const std::string& name, int count) {
  for (const Kernel& kernel : kernels()) {
    if ((name.empty() || name == kernel.name) && count <= kernel.most) return kernel;
  }
  throw std::invalid_argument("this machine runs no kernel " + name + " for " + std::to_string(count) + " descriptors");
}

nb::tuple search(const In& a, const In& b, const std::string& kernel) {
  const int count_a = count_of(a), count_b = count_of(b);
  const Kernel& chosen = kernel_of(kernel, std::max(count_a, count_b));
  Found of_a, of_b;
  Out first = found_of(count_a, of_a), second = found_of(count_b, of_b);
  {
    nb::gil_scoped_release free;
    chosen.search(Descriptors(a.data(), count_a), Descriptors(b.data(), count_b), of_a, of_b);
  }
  return nb::make_tuple(first, second);
}

std::vector<std::string> names() {
  std::vector<std::string> out;
  for (const Kernel& kernel : kernels()) out.emplace_back(kernel.name);
  return out;
}

}  // namespace

NB_MODULE(_nearest, m) {
  m.doc() = "Nearest descriptors of two images, both ways.";
  m.def("kernels", &names);
  m.def("search", &search, "a"_a, "b"_a, "kernel"_a = "");
}
