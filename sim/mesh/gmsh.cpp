#include "sim/mesh/gmsh.hpp"

#include "sim/core/error.hpp"

#if TAUT_HAS_GMSH
#include <fcntl.h>
#include <fmt/format.h>
#include <gmsh.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <sstream>
#include <unordered_map>

#include "sim/mesh/mesh_budget.hpp"
#include "sim/mesh/outline.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

/// One Gmsh session with an empty model.
class Session {
 public:
  Session() {
    gmsh::initialize(0, nullptr, false);
    gmsh::option::setNumber("General.Terminal", 0);
    gmsh::option::setNumber("General.NumThreads", 1);
    gmsh::option::setNumber("Mesh.Algorithm", 6);    // frontal Delaunay: the most even triangles
    gmsh::option::setNumber("Mesh.Algorithm3D", 1);  // Delaunay
    gmsh::option::setNumber("Mesh.RandomSeed", 1);
    gmsh::option::setNumber("Mesh.ElementOrder", 1);  // to_quadratic() adds the mid-nodes
    gmsh::model::add("taut");
  }
  ~Session() {
    try {
      gmsh::finalize();
    } catch (...) {  // the mesh is already read back: nothing is lost
    }
  }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;
};

/// Gmsh is one global object, so sessions of this process exclude each other.
std::mutex& gmsh_mutex() {
  static std::mutex instance;
  return instance;
}

/// Runs `work` in a session and turns what Gmsh throws into an InputError that begins with `what`.
template <class Work>
auto in_session(Work&& work, const std::string& what) {
  try {
    const Session session;
    return work();
  } catch (const InputError&) {
    throw;
  } catch (const std::exception& error) {
    throw InputError(fmt::format("{}: {}", what, error.what()));
  } catch (const std::string& error) {
    throw InputError(fmt::format("{}: {}", what, error));
  } catch (int code) {
    throw InputError(fmt::format("{}: error {}", what, code));
  }
}

/// The same, one at a time.
template <class Work>
Mesh with_gmsh(Work&& work) {
  const std::lock_guard lock(gmsh_mutex());
  return in_session(work, "Gmsh cannot mesh this geometry");
}

/// A path for a mesh, whose file goes with it.
class TemporaryMsh {
 public:
  TemporaryMsh() : path_((std::filesystem::temp_directory_path() / "taut_XXXXXX.msh").string()) {
    const int file = mkstemps(path_.data(), 4);
    if (file < 0)
      throw InputError(fmt::format("cannot write in {}; set TMPDIR", std::filesystem::temp_directory_path().string()));
    close(file);
  }
  ~TemporaryMsh() { std::remove(path_.c_str()); }
  TemporaryMsh(const TemporaryMsh&) = delete;
  TemporaryMsh& operator=(const TemporaryMsh&) = delete;
  const std::string& path() const { return path_; }
  std::string text() const {
    std::ostringstream text;
    text << std::ifstream(path_).rdbuf();
    return text.str();
  }

 private:
  std::string path_;
};

/// Makes the volume that a triangulated surface encloses.
void enclose_surface() {
  constexpr double sharp = 40 * M_PI / 180;  // edges between faces
  gmsh::model::mesh::classifySurfaces(sharp, true, false, M_PI);
  gmsh::model::mesh::createGeometry();
  gmsh::vectorpair faces;
  gmsh::model::getEntities(faces, 2);
  std::vector<int> numbers;
  for (const auto& [dimension, face] : faces) numbers.push_back(face);
  gmsh::model::geo::addVolume({gmsh::model::geo::addSurfaceLoop(numbers)});
  gmsh::model::geo::synchronize();
}

/// Names the entities of a dimension where no physical group has any: as their file does, else "<kind>_<number>" with
/// Gmsh's numbers.
void name_entities(int dimension, const std::string& kind) {
  gmsh::vectorpair groups, entities;
  gmsh::model::getPhysicalGroups(groups, dimension);
  if (!groups.empty()) return;
  gmsh::model::getEntities(entities, dimension);
  for (const auto& [d, number] : entities) {
    std::string name;
    gmsh::model::getEntityName(d, number, name);
    if (const size_t slash = name.rfind('/'); slash != std::string::npos) name = name.substr(slash + 1);
    if (name.starts_with("Open CASCADE STEP translator")) name.clear();  // what stands there for no name
    if (name.empty()) name = fmt::format("{}_{}", kind, number);
    gmsh::model::setPhysicalName(d, gmsh::model::addPhysicalGroup(d, {number}), name);
  }
}

void check_size(double size, int dimension, int order, double cells) {
  if (!(size > 0.0) || !std::isfinite(size)) {
    throw InputError(fmt::format("mesh size {} m must be positive", size));
  }
  if (order != 1 && order != 2) throw InputError(fmt::format("element order {}; 1 and 2 are allowed", order));
  require_mesh(0.7 * cells, dimension, order);  // it may come out coarser where its outline is
  constexpr double most_cells = 1e7;            // Gmsh takes minutes for these
  if (cells > most_cells) {
    throw InputError(
        fmt::format("mesh size {:.4g} mm would make about {:.1g} elements; choose a larger one", 1e3 * size, cells));
  }
}

/// Writes what is in a file as a mesh of format 4.1; see msh_text().
void convert(const std::string& path, int dimension, const std::string& to) {
  in_session(
      [&] {
        gmsh::open(path);
        std::vector<int> types;
        gmsh::model::mesh::getElementTypes(types, dimension);
        if (types.empty()) {
          gmsh::model::mesh::getElementTypes(types);
          if (dimension == 3 && !types.empty()) enclose_surface();
          gmsh::model::mesh::generate(dimension);
        }
        types.clear();
        gmsh::model::mesh::getElementTypes(types, dimension);
        if (types.empty()) {
          const bool plane = gmsh::model::getDimension() == 2;
          throw InputError(fmt::format("{}: Gmsh finds no body of {} dimensions in it{}", path, dimension,
                                       plane ? "; set dimension = 2" : ""));
        }
        name_entities(dimension, dimension == 3 ? "volume" : "surface");
        name_entities(dimension - 1, dimension == 3 ? "surface" : "curve");
        gmsh::option::setNumber("Mesh.MshFileVersion", 4.1);
        gmsh::option::setNumber("Mesh.Binary", 0);
        gmsh::option::setNumber("Mesh.SaveAll", 0);
        gmsh::write(to);
      },
      path + (path.ends_with(".stl") ? ": Gmsh cannot fill this surface; it has to be closed"
                                     : ": Gmsh cannot make a mesh of it"));
}

/// Scales to O(1) numbers and back: Gmsh's tolerances are absolute.
struct Scaling {
  std::vector<double> origin;
  double length;
  double to_gmsh(size_t axis, double x) const { return (x - origin[axis]) / length; }
  double from_gmsh(size_t axis, double x) const { return origin[axis] + length * x; }
};

/// Reads back nodes and elements; remembers which mesh node each Gmsh node became.
class Reader {
 public:
  Reader(Mesh& mesh, const Scaling& scaling) : mesh_(mesh) {
    std::vector<size_t> numbers;
    std::vector<double> coordinates, unused;
    gmsh::model::mesh::getNodes(numbers, coordinates, unused, -1, -1, false, false);
    const size_t d = static_cast<size_t>(mesh.dimension());
    mesh_.X.resize(numbers.size() * d);
    for (size_t i = 0; i < numbers.size(); ++i) {
      index_[numbers[i]] = static_cast<int>(i);
      for (size_t c = 0; c < d; ++c) mesh_.X[i * d + c] = scaling.from_gmsh(c, coordinates[3 * i + c]);
    }
  }

  /// Mesh nodes of all simplices of a Gmsh entity.
  std::vector<int> simplices(int dimension, int entity) const {
    constexpr int gmsh_type[] = {15, 1, 2, 4};
    std::vector<size_t> elements, nodes;
    gmsh::model::mesh::getElementsByType(gmsh_type[dimension], elements, nodes, entity);
    std::vector<int> result;
    for (size_t node : nodes) result.push_back(index_.at(node));
    return result;
  }

  /// Adds the simplices of an entity to a named region.
  void add_region(int entity, const std::string& region) {
    const int d = mesh_.dimension();
    std::vector<int> nodes = simplices(d, entity);
    if (nodes.empty()) throw InputError(fmt::format("Gmsh made no elements in region '{}'", region));
    const int index = mesh_.region_index(region);
    mesh_.elements.insert(mesh_.elements.end(), nodes.begin(), nodes.end());
    for (; mesh_.region.size() < static_cast<size_t>(mesh_.element_count()); mesh_.region.push_back(index)) {
      const int e = static_cast<int>(mesh_.region.size());
      if (vertex_determinant(mesh_, e) < 0.0) flip_element(mesh_.shape, &mesh_.elements[e * (d + 1)]);
    }
  }

 private:
  Mesh& mesh_;
  std::unordered_map<size_t, int> index_;
};

Mesh finished(Mesh mesh, int order, std::string_view where) {
  orient_tags(mesh, where);
  mesh.check(where);
  return order == 1 ? std::move(mesh) : to_quadratic(mesh);
}

std::string name_of_box(const std::vector<BoxRegion>& boxes, size_t k) {
  return fmt::format("box {} (region '{}')", k, boxes[k].region);
}

void check_extents(const std::vector<BoxRegion>& boxes) {
  if (boxes.empty()) throw InputError("no boxes to mesh; give at least one");
  for (size_t k = 0; k < boxes.size(); ++k) {
    if (boxes[k].region.empty()) throw InputError(fmt::format("box {} has no region name; give it one", k));
    for (size_t c = 0; c < 3; ++c) {
      const double extent = boxes[k].upper[c] - boxes[k].lower[c];
      if (!std::isfinite(extent) || extent <= 0.0) {
        throw InputError(fmt::format("{}: along {} it goes from {:.6g} to {:.6g} mm; upper must exceed lower",
                                     name_of_box(boxes, k), "xyz"[c], 1e3 * boxes[k].lower[c],
                                     1e3 * boxes[k].upper[c]));
      }
    }
  }
}

void check_apart(const std::vector<BoxRegion>& boxes) {
  for (size_t k = 0; k < boxes.size(); ++k) {
    for (size_t m = 0; m < k; ++m) {
      bool apart = false;
      for (size_t c = 0; c < 3; ++c) {
        apart = apart || boxes[k].lower[c] >= boxes[m].upper[c] || boxes[m].lower[c] >= boxes[k].upper[c];
      }
      if (!apart) {
        throw InputError(
            fmt::format("{} and {} overlap; boxes may only share faces", name_of_box(boxes, m), name_of_box(boxes, k)));
      }
    }
  }
}

/// The different coordinates of all box faces along one axis, those closer than `tolerance` joined.
std::vector<double> planes(const std::vector<BoxRegion>& boxes, size_t axis, double tolerance) {
  std::vector<double> all;
  for (const BoxRegion& box : boxes) all.insert(all.end(), {box.lower[axis], box.upper[axis]});
  std::sort(all.begin(), all.end());
  std::vector<double> different;
  for (double x : all) {
    if (different.empty() || x - different.back() > tolerance) different.push_back(x);
  }
  return different;
}

/// `x`, or the plane within `tolerance` of it.
double snapped(double x, const std::vector<double>& to, double tolerance) {
  for (double plane : to) {
    if (std::abs(x - plane) <= tolerance) return plane;
  }
  return x;
}

/// Boxes as volumes of the open model that share the faces in which they touch.
void add_boxes(const std::vector<BoxRegion>& boxes, const Scaling& scaling) {
  namespace occ = gmsh::model::occ;
  gmsh::vectorpair volumes;
  for (const BoxRegion& box : boxes) {
    std::array<double, 3> corner, extent;
    for (size_t c = 0; c < 3; ++c) {
      corner[c] = scaling.to_gmsh(c, box.lower[c]);
      extent[c] = scaling.to_gmsh(c, box.upper[c]) - corner[c];
    }
    volumes.emplace_back(3, occ::addBox(corner[0], corner[1], corner[2], extent[0], extent[1], extent[2]));
  }
  if (volumes.size() > 1) {
    gmsh::vectorpair fragments;
    std::vector<gmsh::vectorpair> origins;
    occ::fragment({volumes.front()}, {volumes.begin() + 1, volumes.end()}, fragments, origins);
  }
  occ::synchronize();
}

/// The box around a point in Gmsh's units.
const BoxRegion& box_around(const std::vector<BoxRegion>& boxes, const Scaling& scaling,
                            const std::array<double, 3>& point) {
  const auto owner = std::find_if(boxes.begin(), boxes.end(), [&](const BoxRegion& box) {
    bool inside = true;
    for (size_t c = 0; c < 3; ++c) {
      const double x = scaling.from_gmsh(c, point[c]);
      inside = inside && box.lower[c] < x && x < box.upper[c];
    }
    return inside;
  });
  if (owner == boxes.end()) throw InputError("Gmsh made a volume that belongs to none of the boxes");
  return *owner;
}

}  // namespace

bool has_gmsh() {
  return true;
}

Mesh mesh_polygons(const std::vector<PolygonRegion>& polygons, double size, int order) {
  const Outline outline = outline_of(polygons);
  check_size(size, 2, order, outline.area / (0.43 * size * size));
  const Scaling scaling{{outline.lower[0], outline.lower[1]}, outline.diagonal};
  return with_gmsh([&] {
    namespace geo = gmsh::model::geo;
    std::vector<int> points;
    for (const auto& [x, y] : outline.points) {
      points.push_back(geo::addPoint(scaling.to_gmsh(0, x), scaling.to_gmsh(1, y), 0.0, size / outline.diagonal));
    }
    std::vector<int> lines;
    for (const auto& [a, b] : outline.lines) lines.push_back(geo::addLine(points[a], points[b]));
    std::vector<int> surfaces;
    for (const std::vector<int>& loop : outline.loops) {
      std::vector<int> signed_lines;
      for (int line : loop) signed_lines.push_back(line > 0 ? lines[line - 1] : -lines[-line - 1]);
      surfaces.push_back(geo::addPlaneSurface({geo::addCurveLoop(signed_lines)}));
    }
    geo::synchronize();
    gmsh::option::setNumber("Mesh.MeshSizeMax", size / outline.diagonal);
    // A finely sampled outline must not carry its short edges' size into the whole region.
    gmsh::option::setNumber("Mesh.MeshSizeExtendFromBoundary", 0);
    gmsh::model::mesh::generate(2);

    Mesh mesh;
    mesh.shape = ElementShape::tri3;
    for (const PolygonRegion& polygon : polygons) mesh.add_region(polygon.region);
    Reader reader(mesh, scaling);
    // Undo the round-off of scaling where the exact coordinate is known.
    for (size_t l = 0; l < lines.size(); ++l) {
      const auto& a = outline.points[outline.lines[l][0]];
      const auto& b = outline.points[outline.lines[l][1]];
      for (int node : reader.simplices(1, lines[l])) {
        for (size_t c = 0; c < 2; ++c) {
          if (a[c] == b[c]) mesh.X[2 * node + c] = a[c];
        }
      }
    }
    for (size_t p = 0; p < points.size(); ++p) {
      for (int node : reader.simplices(0, points[p]))
        mesh.X.segment<2>(2 * node) << outline.points[p][0], outline.points[p][1];
    }
    for (size_t k = 0; k < polygons.size(); ++k) reader.add_region(surfaces[k], polygons[k].region);
    for (const auto& [name, tagged] : outline.tags) {
      Tag& tag = mesh.tags[name] = Tag{1, 2, {}};
      for (int line : tagged) {
        const std::vector<int> segments = reader.simplices(1, lines[line]);
        tag.entities.insert(tag.entities.end(), segments.begin(), segments.end());
      }
    }
    return finished(std::move(mesh), order, "mesh of polygons");
  });
}

Mesh mesh_boxes(const std::vector<BoxRegion>& boxes, double size, int order) {
  check_extents(boxes);
  double diagonal = 0.0;
  for (size_t c = 0; c < 3; ++c) {
    const std::vector<double> axis = planes(boxes, c, 0.0);
    diagonal = std::hypot(diagonal, axis.back() - axis.front());
  }
  // Faces that differ by round-off only (0.1 + 0.2 and 0.3) are one plane.
  const double tolerance = 1e-9 * diagonal;
  std::vector<std::vector<double>> planes_of_axis;
  std::vector<BoxRegion> joined = boxes;
  for (size_t c = 0; c < 3; ++c) {
    planes_of_axis.push_back(planes(boxes, c, tolerance));
    for (BoxRegion& box : joined) {
      box.lower[c] = snapped(box.lower[c], planes_of_axis[c], tolerance);
      box.upper[c] = snapped(box.upper[c], planes_of_axis[c], tolerance);
    }
  }
  check_extents(joined);
  check_apart(joined);
  double volume = 0.0;
  for (const BoxRegion& box : joined) {
    volume += (box.upper[0] - box.lower[0]) * (box.upper[1] - box.lower[1]) * (box.upper[2] - box.lower[2]);
  }
  check_size(size, 3, order, volume / (0.12 * size * size * size));
  const Scaling scaling{{planes_of_axis[0].front(), planes_of_axis[1].front(), planes_of_axis[2].front()}, diagonal};

  return with_gmsh([&] {
    add_boxes(joined, scaling);
    gmsh::option::setNumber("Mesh.MeshSizeMax", size / diagonal);
    gmsh::model::mesh::generate(3);

    Mesh mesh;
    mesh.shape = ElementShape::tet4;
    for (const BoxRegion& box : joined) mesh.add_region(box.region);
    Reader reader(mesh, scaling);
    for (Eigen::Index i = 0; i < mesh.X.size(); ++i) mesh.X[i] = snapped(mesh.X[i], planes_of_axis[i % 3], tolerance);
    gmsh::vectorpair pieces;
    gmsh::model::getEntities(pieces, 3);
    for (const auto& [dimension, piece] : pieces) {
      std::array<double, 3> centre;
      gmsh::model::occ::getCenterOfMass(dimension, piece, centre[0], centre[1], centre[2]);
      reader.add_region(piece, box_around(joined, scaling, centre).region);
    }
    // Exact, because nodes were snapped to the planes.
    tag_sides(mesh, [&](int node, int axis, bool upper) {
      return mesh.X[3 * node + axis] == (upper ? planes_of_axis[axis].back() : planes_of_axis[axis].front());
    });
    return finished(std::move(mesh), order, "mesh of boxes");
  });
}

std::string msh_text(const std::string& path, int dimension) {
  // In a process of its own: Gmsh's parsers may break down over what is no geometry, and print.
  const TemporaryMsh file;
  constexpr int refused = 2;
  constexpr rlim_t most_of_gmsh = 600;  // [s] of its processor
  std::unique_lock lock(gmsh_mutex());  // nobody is in the middle of a session that the child would inherit
  const pid_t parent = getpid(), child = fork();
  if (child == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);  // it ends with us, however that is
    if (getppid() != parent) _exit(1);
    const rlimit cpu{most_of_gmsh, most_of_gmsh + 10};  // a loop without end
    setrlimit(RLIMIT_CPU, &cpu);
    for (int signal : {SIGINT, SIGTERM, SIGHUP}) std::signal(signal, SIG_DFL);
    const int nowhere = open("/dev/null", O_WRONLY);
    dup2(nowhere, STDOUT_FILENO);
    dup2(nowhere, STDERR_FILENO);
    int code = 0;
    try {
      convert(path, dimension, file.path());
    } catch (const std::exception& error) {
      std::ofstream(file.path()) << error.what();
      code = refused;
    }
    _exit(code);
  }
  lock.unlock();
  if (child < 0) throw InputError(fmt::format("{}: no process for Gmsh: {}", path, std::strerror(errno)));
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  std::string text = file.text();
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return text;
  if (WIFEXITED(status) && WEXITSTATUS(status) == refused) throw InputError(text);
  if (WIFSIGNALED(status) && WTERMSIG(status) == SIGXCPU)
    throw InputError(
        fmt::format("{}: Gmsh does not come to an end with it within {} minutes; save it as .msh from Gmsh "
                    "itself",
                    path, most_of_gmsh / 60));
  throw InputError(fmt::format("{}: Gmsh breaks down over it; open it in Gmsh itself, or save it as .msh there", path));
}

}  // namespace taut

#else

namespace taut {
namespace {

[[noreturn]] void refuse() {
  throw InputError("this build has no Gmsh; configure with -DTAUT_GMSH=ON, or read a .msh file instead");
}

}  // namespace

bool has_gmsh() {
  return false;
}
Mesh mesh_polygons(const std::vector<PolygonRegion>&, double, int) {
  refuse();
}
Mesh mesh_boxes(const std::vector<BoxRegion>&, double, int) {
  refuse();
}
std::string msh_text(const std::string& path, int) {
  throw InputError(
      path +
      ": this build has no Gmsh, and reads its formats 4.1 and 2.2 in ASCII only; convert it: gmsh -3 -format "
      "msh41 -o mesh.msh FILE");
}

}  // namespace taut
#endif
