#include "sim/mesh/msh_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <set>
#include <sstream>
#include <unordered_map>

#include "sim/core/error.hpp"
#include "sim/core/input_file.hpp"
#include "sim/mesh/gmsh.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

using Number = std::int64_t;
using EntityKey = std::pair<int, Number>;  ///< dimension and number: of a geometrical entity or a physical group

/// The lines of a file, or of the text that Gmsh made of it, split into words. Every error carries the path, and the
/// line where that can be looked up.
class Lines {
 public:
  Lines(const std::string& path, std::unique_ptr<std::istream> file, bool made_by_gmsh)
      : path_(path), file_(std::move(file)), made_by_gmsh_(made_by_gmsh) {}

  [[noreturn]] void fail(const std::string& what) const { fail_at(line_, what); }
  [[noreturn]] void fail_at(Number line, const std::string& what) const {
    throw InputError(made_by_gmsh_ ? fmt::format("{}: as a mesh: {}", path_, what)
                                   : fmt::format("{}:{}: {}", path_, line, what));
  }
  /// "the element on line 12", where that can be looked up.
  std::string element_at(Number line) const {
    return made_by_gmsh_ ? "another element" : fmt::format("the element on line {}", line);
  }

  /// Moves to the next line that is not blank; false at the end of the file.
  bool next() {
    while (std::getline(*file_, text_)) {
      ++line_;
      split();
      if (!words_.empty()) return true;
    }
    return false;
  }

  /// Moves to the next line, which must have at least `count` words.
  void expect_words(size_t count, std::string_view what) {
    if (!next()) fail(fmt::format("the file ends where {} should follow; save it again", what));
    if (words_.size() < count) fail(fmt::format("expected {} ({} values), found '{}'", what, count, shown()));
  }

  void expect_end(const std::string& section) {
    if (!next()) fail(fmt::format("the file ends before $End{}; save it again", section));
    if (words_[0] != "$End" + section) {
      fail(fmt::format("expected $End{} after the announced number of lines, found '{}'", section, shown()));
    }
  }

  void skip_to_end(const std::string& section) {
    while (next()) {
      if (words_[0] == "$End" + section) return;
    }
    fail(fmt::format("the file ends before $End{}; save it again", section));
  }

  Number line() const { return line_; }
  const std::string& text() const { return text_; }
  const std::string& path() const { return path_; }
  size_t size() const { return words_.size(); }
  std::string word(size_t i) const { return std::string(words_[i]); }

  Number integer(size_t i, std::string_view what) const {
    Number value = 0;
    if (i < words_.size() && parse(words_[i], value)) return value;
    fail(fmt::format("{} is '{}'; expected a whole number", what, i < words_.size() ? words_[i] : "missing"));
  }

  Number count(size_t i, std::string_view what) const {
    const Number value = integer(i, what);
    if (value < 0) fail(fmt::format("{} is {}; expected zero or more", what, value));
    return value;
  }

  /// A physical group: its sign says which way round its entities are.
  Number group(size_t i) const {
    const Number value = integer(i, "a physical group");
    if (value == std::numeric_limits<Number>::min()) fail(fmt::format("{} is no number of a physical group", value));
    return std::abs(value);
  }

  double real(size_t i, std::string_view what) const {
    double value = 0.0;
    if (i < words_.size() && parse(words_[i], value) && std::isfinite(value)) return value;
    fail(fmt::format("{} is '{}'; expected a finite number", what, i < words_.size() ? words_[i] : "missing"));
  }

 private:
  template <class Value>
  static bool parse(std::string_view word, Value& value) {
    if (!word.empty() && word.front() == '+') word.remove_prefix(1);
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    return error == std::errc{} && end == word.data() + word.size();
  }

  std::string shown() const { return text_.substr(0, 60); }

  void split() {
    if (!text_.empty() && text_.back() == '\r') text_.pop_back();
    words_.clear();
    const std::string_view text = text_;
    constexpr std::string_view blanks = " \t";
    for (size_t first = text.find_first_not_of(blanks); first != std::string_view::npos;) {
      const size_t last = std::min(text.find_first_of(blanks, first), text.size());
      words_.push_back(text.substr(first, last - first));
      first = text.find_first_not_of(blanks, last);
    }
  }

  std::string path_;
  std::unique_ptr<std::istream> file_;
  bool made_by_gmsh_;
  std::string text_;
  std::vector<std::string_view> words_;
  Number line_ = 0;
};

/// What is known of an element type that can be read.
struct ElementType {
  int dimension, order, nodes;
};

ElementType element_type(Number type, const Lines& lines) {
  static const std::map<Number, ElementType> types{{15, {0, 0, 1}}, {1, {1, 1, 2}}, {8, {1, 2, 3}},  {2, {2, 1, 3}},
                                                   {9, {2, 2, 6}},  {4, {3, 1, 4}}, {11, {3, 2, 10}}};
  static const std::map<Number, std::string> others{
      {3, "quadrangle"},  {5, "hexahedron"}, {6, "prism"},     {7, "pyramid"},     {10, "quadrangle"},
      {12, "hexahedron"}, {13, "prism"},     {14, "pyramid"},  {16, "quadrangle"}, {17, "hexahedron"},
      {18, "prism"},      {19, "pyramid"},   {21, "triangle"}, {26, "line"},       {29, "tetrahedron"}};
  if (const auto found = types.find(type); found != types.end()) return found->second;
  const auto other = others.find(type);
  lines.fail(
      fmt::format("element type {}{} is not supported; mesh with triangles or tetrahedra of order 1 or 2 and "
                  "without recombination",
                  type, other == others.end() ? "" : " (" + other->second + ")"));
}

struct FileElement {
  Number line;
  Number number;
  ElementType type;
  std::vector<Number> groups;  ///< physical groups of the element's dimension
  std::vector<Number> nodes;
};

class MshReader {
 public:
  MshReader(const std::string& path, std::unique_ptr<std::istream> file, bool made_by_gmsh, double unit)
      : lines_(path, std::move(file), made_by_gmsh), unit_(unit) {}

  Mesh read() {
    while (lines_.next()) read_section();
    if (!seen_.contains("MeshFormat")) lines_.fail("no $MeshFormat section: this is no Gmsh mesh file");
    for (const char* section : {"Nodes", "Elements"}) {
      if (!seen_.contains(section))
        lines_.fail(fmt::format("no ${} section; save the mesh, not only the geometry", section));
    }
    return assemble();
  }

 private:
  void read_section() {
    const std::string header = lines_.word(0);
    if (header[0] != '$' || header.rfind("$End", 0) == 0) {
      lines_.fail(fmt::format("expected a section such as $Nodes, found '{}'", lines_.text().substr(0, 60)));
    }
    const std::string section = header.substr(1);
    static const std::map<std::string, std::array<void (MshReader::*)(), 2>> readers{
        // in formats 2.2 and 4.1
        {"MeshFormat", {&MshReader::read_format, &MshReader::read_format}},
        {"PhysicalNames", {&MshReader::read_names, &MshReader::read_names}},
        {"Entities", {nullptr, &MshReader::read_entities}},
        {"Nodes", {&MshReader::read_nodes_22, &MshReader::read_nodes_41}},
        {"Elements", {&MshReader::read_elements_22, &MshReader::read_elements_41}}};
    const auto reader = readers.find(section);
    if (section == "PartitionedEntities") {
      lines_.fail("partitioned meshes are not supported; save the mesh without partitions");
    }
    if (reader == readers.end()) return lines_.skip_to_end(section);
    if (!seen_.insert(section).second) lines_.fail(fmt::format("a second ${} section; keep one", section));
    if (section != "MeshFormat" && !seen_.contains("MeshFormat")) {
      lines_.fail(fmt::format("${} before $MeshFormat: this is no Gmsh mesh file", section));
    }
    const auto read = reader->second[new_format_ ? 1 : 0];
    if (read == nullptr) return lines_.skip_to_end(section);
    (this->*read)();
    lines_.expect_end(section);
  }

  void read_format() {
    lines_.expect_words(3, "version, file type and data size");
    const std::string version = lines_.word(0);
    new_format_ = version == "4.1";
  }

  void read_names() {
    lines_.expect_words(1, "the number of physical names");
    for (Number left = lines_.count(0, "the number of physical names"); left > 0; --left) {
      lines_.expect_words(3, "dimension, number and name of a physical group");
      const EntityKey key{static_cast<int>(lines_.integer(0, "the dimension of a physical group")),
                          lines_.integer(1, "the number of a physical group")};
      const std::string& text = lines_.text();
      const size_t first = text.find('"'), last = text.rfind('"');
      if (first == std::string::npos || last <= first + 1) {
        lines_.fail("the name of a physical group must be in double quotes and not empty");
      }
      names_[key] = text.substr(first + 1, last - first - 1);
    }
  }

  void read_entities() {
    lines_.expect_words(4, "the numbers of points, curves, surfaces and volumes");
    Number counts[4];
    for (size_t d = 0; d < 4; ++d) counts[d] = lines_.count(d, "the number of entities");
    for (int d = 0; d < 4; ++d) {
      const size_t before = d == 0 ? 4 : 7;  // number and point, or number and bounding box
      for (Number left = counts[d]; left > 0; --left) {
        lines_.expect_words(before + 1, "an entity with its coordinates and physical groups");
        const Number number = lines_.integer(0, "the number of an entity");
        std::vector<Number>& groups = groups_of_entity_[{d, number}];
        const Number count = lines_.count(before, "the number of physical groups");
        for (Number g = 0; g < count; ++g) {
          // A negative number asks Gmsh to save the elements reversed; they are oriented here anyway.
          groups.push_back(lines_.group(before + 1 + g));
        }
      }
    }
  }

  void add_node(Number number, size_t first_coordinate) {
    if (!index_of_node_.try_emplace(number, nodes_.size()).second) {
      lines_.fail(fmt::format("node {} occurs twice", number));
    }
    Eigen::Vector3d position;
    for (int c = 0; c < 3; ++c) {
      constexpr double farthest = 1e6;  // [m]
      position[c] = unit_ * lines_.real(first_coordinate + c, "a coordinate");
      if (std::abs(position[c]) > farthest)
        lines_.fail(fmt::format("node {} has a coordinate of {:.4g} m; correct it, or the unit", number, position[c]));
    }
    nodes_.push_back(position);
  }

  void read_nodes_22() {
    lines_.expect_words(1, "the number of nodes");
    for (Number left = lines_.count(0, "the number of nodes"); left > 0; --left) {
      lines_.expect_words(4, "a node number and three coordinates");
      add_node(lines_.integer(0, "a node number"), 1);
    }
  }

  void read_nodes_41() {
    lines_.expect_words(4, "the numbers of node blocks and nodes");
    for (Number blocks = lines_.count(0, "the number of node blocks"); blocks > 0; --blocks) {
      lines_.expect_words(4, "dimension, entity, 0 or 1, and number of nodes");
      const Number count = lines_.count(3, "the number of nodes in the block");
      std::vector<Number> numbers;
      for (Number left = count; left > 0; --left) {
        lines_.expect_words(1, "a node number");
        numbers.push_back(lines_.integer(0, "a node number"));
      }
      for (Number number : numbers) {
        lines_.expect_words(3, "three coordinates");
        add_node(number, 0);
      }
    }
  }

  void add_element(const ElementType& type, std::vector<Number> groups, size_t first_node) {
    FileElement element{lines_.line(), lines_.integer(0, "an element number"), type, std::move(groups), {}};
    if (lines_.size() != first_node + type.nodes) {
      lines_.fail(fmt::format("element {} has {} nodes; its type has {}", element.number,
                              static_cast<Number>(lines_.size()) - static_cast<Number>(first_node), type.nodes));
    }
    for (int a = 0; a < type.nodes; ++a) {
      element.nodes.push_back(lines_.integer(first_node + a, "a node number"));
    }
    // Gmsh numbers the tetrahedron's last two mid-nodes the other way round.
    if (type.nodes == 10) std::swap(element.nodes[8], element.nodes[9]);
    elements_.push_back(std::move(element));
  }

  void read_elements_22() {
    lines_.expect_words(1, "the number of elements");
    for (Number left = lines_.count(0, "the number of elements"); left > 0; --left) {
      lines_.expect_words(4, "an element's number, type, tags and nodes");
      const ElementType type = element_type(lines_.integer(1, "an element type"), lines_);
      const Number tags = lines_.count(2, "the number of an element's tags");
      std::vector<Number> groups;
      const Number group = tags > 0 ? lines_.group(3) : 0;
      if (group != 0) groups.push_back(group);
      if (tags > static_cast<Number>(lines_.size()))
        lines_.fail(fmt::format("{} tags are announced, fewer follow", tags));
      add_element(type, std::move(groups), 3 + tags);
    }
  }

  void read_elements_41() {
    lines_.expect_words(4, "the numbers of element blocks and elements");
    for (Number blocks = lines_.count(0, "the number of element blocks"); blocks > 0; --blocks) {
      lines_.expect_words(4, "dimension, entity, element type and number of elements");
      const EntityKey entity{static_cast<int>(lines_.integer(0, "the dimension of an element block")),
                             lines_.integer(1, "the entity of an element block")};
      const ElementType type = element_type(lines_.integer(2, "an element type"), lines_);
      const auto groups = groups_of_entity_.find(entity);
      for (Number left = lines_.count(3, "the number of elements in the block"); left > 0; --left) {
        lines_.expect_words(2, "an element number and its nodes");
        add_element(type, groups == groups_of_entity_.end() ? std::vector<Number>{} : groups->second, 1);
      }
    }
  }

  std::string name_of_group(int dimension, Number group) const {
    const auto found = names_.find({dimension, group});
    return found == names_.end() ? fmt::format("physical_{}", group) : found->second;
  }

  size_t node_index(const FileElement& element, Number number) const {
    const auto found = index_of_node_.find(number);
    if (found == index_of_node_.end()) {
      lines_.fail_at(element.line,
                     fmt::format("element {} refers to node {}, which the file does not have", element.number, number));
    }
    return found->second;
  }

  /// Shape of the mesh; throws when elements of the highest dimension differ in order, or any other does not fit them.
  ElementShape shape_of_elements() const {
    const auto highest =
        std::ranges::max_element(elements_, {}, [](const FileElement& element) { return element.type.dimension; });
    if (highest == elements_.end() || highest->type.dimension < 2) {
      lines_.fail("the file has no triangles and no tetrahedra; mesh in 2D or 3D before saving");
    }
    for (const FileElement& element : elements_) {
      if (element.type.dimension > 0 && element.type.order != highest->type.order) {
        lines_.fail_at(element.line,
                       fmt::format("mixed element orders: element {} has order {}, element {} order {}; "
                                   "set one order for the whole mesh",
                                   element.number, element.type.order, highest->number, highest->type.order));
      }
    }
    const bool linear = highest->type.order == 1;
    if (highest->type.dimension == 2) return linear ? ElementShape::tri3 : ElementShape::tri6;
    return linear ? ElementShape::tet4 : ElementShape::tet10;
  }

  Mesh assemble() {
    Mesh mesh;
    mesh.shape = shape_of_elements();
    number_nodes(mesh);
    add_regions(mesh);
    add_tags(mesh);
    orient_tags(mesh, lines_.path());
    mesh.check(lines_.path());
    return mesh;
  }

  /// Gives mesh numbers, in the order of the file, to the nodes of elements of the highest dimension.
  void number_nodes(Mesh& mesh) {
    const int d = mesh.dimension();
    mesh_number_.assign(nodes_.size(), -1);
    for (const FileElement& element : elements_) {
      if (element.type.dimension != d) continue;
      for (Number node : element.nodes) mesh_number_[node_index(element, node)] = 0;
    }
    int used = 0;
    for (int& number : mesh_number_) number = number < 0 ? -1 : used++;
    remark_unused(mesh);
    mesh.X.resize(used * d);
    Eigen::Matrix3Xd positions(3, used);
    for (size_t i = 0; i < nodes_.size(); ++i) {
      if (mesh_number_[i] < 0) continue;
      positions.col(mesh_number_[i]) = nodes_[i];
      mesh.X.segment(mesh_number_[i] * d, d) = nodes_[i].head(d);
    }
    const Eigen::Vector3d extent = positions.rowwise().maxCoeff() - positions.rowwise().minCoeff();
    if (d == 2 && extent[2] > 1e-9 * extent.norm()) {
      // The plane is where most nodes are; what lies farthest from it is the one to look at.
      std::vector<double> heights(positions.row(2).begin(), positions.row(2).end());
      std::ranges::nth_element(heights, heights.begin() + used / 2);
      Eigen::Index farthest = 0;
      (positions.row(2).array() - heights[static_cast<size_t>(used / 2)]).abs().maxCoeff(&farthest);
      lines_.fail(
          fmt::format("triangles only, but z varies by {:.4g} mm, a node is at {}: a surface in space is not "
                      "supported; mesh the volume, or draw the outline at one z",
                      1e3 * extent[2], in_millimetres(positions.col(farthest))));
    }
  }

  /// Construction points, say. They would be free to move.
  void remark_unused(Mesh& mesh) const {
    const auto count = std::ranges::count(mesh_number_, -1);
    if (count == 0) return;
    const auto first = static_cast<size_t>(std::ranges::find(mesh_number_, -1) - mesh_number_.begin());
    mesh.remarks.push_back(fmt::format("{}: {} in no {}, {}at {}; left out", lines_.path(),
                                       count == 1 ? "1 node is" : fmt::format("{} nodes are", count),
                                       mesh.dimension() == 2 ? "triangle" : "tetrahedron",
                                       count == 1 ? "" : "the first ",
                                       in_millimetres(nodes_[first].head(mesh.dimension()))));
  }

  void add_regions(Mesh& mesh) {
    const int d = mesh.dimension();
    std::set<std::pair<Number, std::string>> groups;
    for (const FileElement& element : elements_) {
      if (element.type.dimension != d) continue;
      if (element.groups.empty()) {
        lines_.fail_at(element.line,
                       fmt::format("element {} is in no physical group; put every {} in one, e.g. Physical "
                                   "{}(\"body\") = {{1}}",
                                   element.number, d == 2 ? "surface" : "volume", d == 2 ? "Surface" : "Volume"));
      }
      for (Number group : element.groups) groups.emplace(group, name_of_group(d, group));
    }
    for (const auto& [group, name] : groups) mesh.add_region(name);
    std::map<std::vector<Number>, const FileElement*> known;  // by their vertices
    int turned = 0, repeated = 0;
    for (const FileElement& element : elements_) {
      if (element.type.dimension != d) continue;
      std::vector<Number> vertices(element.nodes.begin(), element.nodes.begin() + d + 1);
      std::sort(vertices.begin(), vertices.end());
      const auto [first, is_new] = known.try_emplace(vertices, &element);
      const std::string region = name_of_group(d, element.groups[0]);
      if (!is_new && element.groups.size() == 1 && name_of_group(d, first->second->groups[0]) == region) {
        ++repeated;
        continue;
      }
      // Format 2.2 repeats an element for each of its groups.
      if (!is_new || element.groups.size() > 1) {
        lines_.fail_at(
            element.line,
            fmt::format("element {} {}; every element belongs to one region only", element.number,
                        is_new ? fmt::format("is in the physical groups '{}' and '{}'",
                                             name_of_group(d, element.groups[0]), name_of_group(d, element.groups[1]))
                               : "has the vertices of " + lines_.element_at(first->second->line)));
      }
      for (Number node : element.nodes) mesh.elements.push_back(mesh_number_[node_index(element, node)]);
      mesh.region.push_back(mesh.region_index(region));
      const int e = mesh.element_count() - 1;
      if (vertex_determinant(mesh, e) >= 0.0) continue;
      flip_element(mesh.shape, &mesh.elements[e * mesh.nodes_per_element()]);
      ++turned;
    }
    // All the same way round is a convention of who wrote the file.
    if (turned > 0 && turned < mesh.element_count())
      mesh.remarks.push_back(fmt::format("{}: {} of {} elements list their nodes the other way round; turned",
                                         lines_.path(), turned, mesh.element_count()));
    if (repeated > 0)
      mesh.remarks.push_back(fmt::format("{}: {} listed twice; each counts once", lines_.path(),
                                         repeated == 1 ? "1 element is" : fmt::format("{} elements are", repeated)));
  }

  /// Facets, lines and points of physical groups, each once: what multiplies by a tag's measure would count it twice.
  void add_tags(Mesh& mesh) {
    std::set<std::pair<std::string, std::vector<Number>>> known;
    std::map<std::string, int> repeated;
    for (const FileElement& element : elements_) {
      const int dimension = element.type.dimension;
      if (dimension == mesh.dimension()) continue;
      for (Number group : element.groups) {
        const std::string name = name_of_group(dimension, group);
        Tag& tag = mesh.tags.try_emplace(name, Tag{dimension, element.type.nodes, {}}).first->second;
        if (tag.dimension != dimension) {
          lines_.fail_at(element.line,
                         fmt::format("physical groups of dimensions {} and {} are both called '{}'; rename "
                                     "one",
                                     tag.dimension, dimension, name));
        }
        std::vector<Number> sorted = element.nodes;
        std::ranges::sort(sorted);
        if (!known.emplace(name, std::move(sorted)).second) {
          ++repeated[name];
          continue;
        }
        for (Number node : element.nodes) {
          const int number = mesh_number_[node_index(element, node)];
          if (number < 0) {
            lines_.fail_at(element.line,
                           fmt::format("node {} of physical group '{}' belongs to no {}; tag only parts of "
                                       "the mesh",
                                       node, name, mesh.dimension() == 2 ? "triangle" : "tetrahedron"));
          }
          tag.entities.push_back(number);
        }
      }
    }
    for (const auto& [name, count] : repeated)
      mesh.remarks.push_back(
          fmt::format("{}: '{}' lists {} of its entities twice; each counts once", lines_.path(), name, count));
  }

  Lines lines_;
  double unit_;
  bool new_format_ = false;
  std::set<std::string> seen_;
  std::map<EntityKey, std::string> names_;
  std::map<EntityKey, std::vector<Number>> groups_of_entity_;
  std::vector<Eigen::Vector3d> nodes_;
  std::unordered_map<Number, size_t> index_of_node_;
  std::vector<FileElement> elements_;
  std::vector<int> mesh_number_;  ///< of each file node; -1 for nodes of no element
};

constexpr double most_of_mesh = 20e9;  // [bytes]; read line by line

/// Whether it is no ASCII mesh of the formats 4.1 and 2.2; what calls itself .msh and is no mesh at all is one with
/// errors.
bool is_for_gmsh(const std::string& path) {
  if (std::filesystem::path(path).extension() != ".msh") return true;
  std::ifstream file(path);
  std::string first, version, type;
  file >> first >> version >> type;
  if (first == "$NOD") return true;  // format 1
  return first == "$MeshFormat" && !type.empty() && ((version != "4.1" && version != "2.2") || type != "0");
}

}  // namespace

Mesh read_msh(const std::string& path, double unit, int dimension) {
  if (!(unit > 0.0) || !std::isfinite(unit)) {
    throw InputError(fmt::format("{}: unit {} m must be positive; 0.001 for a mesh in millimetres", path, unit));
  }
  check_input_file(path, most_of_mesh);
  if (is_for_gmsh(path)) {
    return MshReader(path, std::make_unique<std::istringstream>(msh_text(path, dimension)), true, unit).read();
  }
  return MshReader(path, std::make_unique<std::ifstream>(path), false, unit).read();
}

}  // namespace taut
