#include "sim/terms/joint.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/sorted.hpp"
#include "sim/mesh/topology.hpp"
#include "sim/model/node_set.hpp"

namespace taut {
namespace {

/// The points of a joint, the columns of what follows; in 2D those of the axis' end stay unused.
enum Place { s_a, s_b, t_a, t_b, e_a, e_b, places };
using Places = Eigen::Matrix<double, 3, places>;
using Vector = Eigen::VectorXd;                        ///< 3 places
using Matrix = Eigen::MatrixXd;                        ///< 3 places x 3 places
using Row = Eigen::Matrix<double, 3, Eigen::Dynamic>;  ///< 3 x 3 places

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& a) {
  Eigen::Matrix3d m;
  m << 0, -a[2], a[1], a[2], 0, -a[0], -a[1], a[0], 0;
  return m;
}

/// along a + across n x a + axial (n . a) n: the rotation by theta about n for (cos, sin, 1 - cos), and its derivatives
/// with respect to theta for theirs.
struct Turn {
  double along, across, axial;

  Eigen::Matrix3d matrix(const Eigen::Vector3d& n) const {
    return along * Eigen::Matrix3d::Identity() + across * cross_matrix(n) + axial * n * n.transpose();
  }
  /// d(matrix a)/dn.
  Eigen::Matrix3d by_axis(const Eigen::Vector3d& n, const Eigen::Vector3d& a) const {
    return -across * cross_matrix(a) + axial * (n * a.transpose() + n.dot(a) * Eigen::Matrix3d::Identity());
  }
};

void check(const Mesh& mesh, const Joint& joint) {
  const int d = mesh.dimension();
  const auto fail = [&](const std::string& what) { throw InputError(fmt::format("joint '{}': {}", joint.name, what)); };
  const auto check_pair = [&](const Attachment& a, const Attachment& b, const char* what) {
    if (a.point.size() != d || b.point.size() != d || !a.point.allFinite() || !b.point.allFinite())
      fail(fmt::format("{} needs {} finite coordinates on either side", what, d));
    if (!((a.point - b.point).norm() <= 1e-9 * mesh.diagonal()))
      fail(fmt::format("{} must be one point at rest, and is {} on one side and {} on the other; give both the same",
                       what, in_millimetres(a.point), in_millimetres(b.point)));
    if (a.nodes.empty() && b.nodes.empty())
      fail(fmt::format("{} is fixed in space on both sides; attach one of them to a body", what));
  };
  check_pair(joint.pivot_a, joint.pivot_b, "the pivot");
  if (d == 3) {
    check_pair(joint.axis_a, joint.axis_b, "the end of the axis");
    if (!((joint.axis_a.point - joint.pivot_a.point).norm() > 1e-9 * mesh.diagonal()))
      fail("its axis has no length; give it a second point away from the pivot");
  }
  if (joint.motor_b.point.size() == 0) {
    if (joint.angle >= 0) fail("it has an angle, but no motor point that turns; give it one off the axis");
    return;
  }
  check_pair(joint.motor_a, joint.motor_b, "the motor point");
  Eigen::VectorXd arm = joint.motor_a.point - joint.pivot_a.point;
  if (d == 3) {
    const Eigen::VectorXd n = (joint.axis_a.point - joint.pivot_a.point).normalized();
    arm -= n.dot(arm) * n;
  }
  if (!(arm.norm() > 1e-9 * mesh.diagonal())) fail("its motor point lies on its axis; move it off");
}

/// Places of a joint's points as functions of the displacements, and the energies of the springs between them.
class Springs {
 public:
  Springs(const Mesh& mesh, const Joint& joint) : on_{{}, mesh.dimension()} {
    check(mesh, joint);
    has_motor_point_ = joint.motor_b.point.size() > 0;
    const Attachment none;
    std::vector<const Attachment*> points{&joint.pivot_a, &joint.pivot_b, has_motor_point_ ? &joint.motor_a : &none,
                                          has_motor_point_ ? &joint.motor_b : &none};
    if (on_.dimension == 3) points.insert(points.end(), {&joint.axis_a, &joint.axis_b});
    std::vector<int>& nodes = on_.nodes;
    for (const Attachment* point : points) nodes.insert(nodes.end(), point->nodes.begin(), point->nodes.end());
    sort_unique(nodes);
    const int d = on_.dimension;
    to_nodes_ = Eigen::MatrixXd::Zero(on_.count() * d, 3 * places);
    for (size_t p = 0; p < points.size(); ++p) {
      if (points[p] == &none) continue;
      // Both sides start from the same place, to the last digit: differences are those of the displacements.
      rest_.col(p).head(d) = points[p - p % 2]->point;
      for (size_t i = 0; i < points[p]->nodes.size(); ++i) {
        const Eigen::Index a = std::lower_bound(nodes.begin(), nodes.end(), points[p]->nodes[i]) - nodes.begin();
        for (Eigen::Index c = 0; c < d; ++c) to_nodes_(a * d + c, 3 * p + c) += points[p]->weights[i];
      }
    }
  }

  const NodeSet& on() const { return on_; }
  bool has_motor_point() const { return has_motor_point_; }

  /// Displacements of the points.
  Places displacements(const Eigen::VectorXd& u) const {
    const Eigen::VectorXd local = on_.gather(u).reshaped();
    return (to_nodes_.transpose() * local).reshaped(3, static_cast<Eigen::Index>(places));
  }
  Places positions(const Places& v) const { return rest_ + v; }

  /// Derivatives with respect to the points into those with respect to the nodes.
  Eigen::VectorXd on_nodes(const Vector& g) const { return to_nodes_ * g; }
  Eigen::MatrixXd on_nodes(const Matrix& H) const {
    const Matrix left = to_nodes_ * H;
    return left * to_nodes_.transpose();
  }
  void scatter(const Vector& g, Eigen::VectorXd& all) const { on_.scatter(on_nodes(g), all); }
  Eigen::VectorXd spread(const Vector& g, const Point& at) const { return on_.spread(on_nodes(g), at.u.size()); }

  /// The pins for k = 1: 1/2 |gap|^2 is quadratic.
  double pin_energy(const Places& v) const { return 0.5 * pin_gradient(v).squaredNorm() / 2; }
  Vector pin_gradient(const Places& v) const {
    Places g = Places::Zero();
    for (const auto& [a, b] : {std::pair{s_a, s_b}, std::pair{e_a, e_b}}) {
      g.col(a) = v.col(a) - v.col(b);
      g.col(b) = -g.col(a);
    }
    return g.reshaped();
  }
  static Matrix pin_hessian() {
    Matrix H = Matrix::Zero(3 * places, 3 * places);
    for (const auto& [a, b] : {std::pair{s_a, s_b}, std::pair{e_a, e_b}}) {
      for (int c = 0; c < 3; ++c) {
        H(3 * a + c, 3 * a + c) = H(3 * b + c, 3 * b + c) = 1;
        H(3 * a + c, 3 * b + c) = H(3 * b + c, 3 * a + c) = -1;
      }
    }
    return H;
  }

  /// The axis n, out of the plane in 2D, and dn/de of its vector e = s2_A - s_A.
  struct Axis {
    Eigen::Vector3d n = Eigen::Vector3d::UnitZ();
    Eigen::Matrix3d derivative = Eigen::Matrix3d::Zero();
    double length = 1;
  };
  Axis axis(const Places& x) const {
    Axis axis;
    if (on_.dimension == 2) return axis;
    const Eigen::Vector3d e = x.col(e_a) - x.col(s_a);
    axis.length = e.norm();
    axis.n = e / axis.length;
    axis.derivative = (Eigen::Matrix3d::Identity() - axis.n * axis.n.transpose()) / axis.length;
    return axis;
  }

  /// What the motor's spring has at one state and angle, for k = 1: r = t_B - t_C, and its derivatives.
  struct Motor {
    Eigen::Vector3d r, by_angle, by_angle_twice;  ///< r [m], dr/dtheta, d2r/dtheta2
    Row by_points, mixed;                         ///< dr/dv, d2r/(dtheta dv)
    Matrix curvature;                             ///< sum_i r_i d2 r_i/dv2; zero in 2D
  };
  Motor motor(const Places& v, double theta) const {
    const Places x = positions(v);
    const Axis axis = this->axis(x);
    const Eigen::Vector3d a = x.col(t_a) - x.col(s_a), &n = axis.n;
    const double c = std::cos(theta), s = std::sin(theta), half = std::sin(0.5 * theta);
    const Turn turn{c, s, 2 * half * half}, first{-s, c, s}, second{-c, -s, c};
    Motor motor;
    // t_B - s_A - R a = v_tB - v_tA + (I - R) a, because the motor points coincide at rest.
    motor.r = v.col(t_b) - v.col(t_a) + turn.axial * (a - n.dot(a) * n) - s * n.cross(a);
    motor.by_angle = -first.matrix(n) * a;
    motor.by_angle_twice = -second.matrix(n) * a;
    motor.by_points = chain(turn, axis, a);
    motor.by_points.middleCols<3>(3 * s_a) -= Eigen::Matrix3d::Identity();
    motor.by_points.middleCols<3>(3 * t_b) += Eigen::Matrix3d::Identity();
    motor.mixed = chain(first, axis, a);
    motor.curvature = Matrix::Zero(3 * places, 3 * places);
    if (on_.dimension == 3) add_axis_curvature(turn, axis, a, motor.r, motor.curvature);
    return motor;
  }

 private:
  /// Derivative of - turn(n) a with respect to the points.
  static Row chain(const Turn& turn, const Axis& axis, const Eigen::Vector3d& a) {
    const Eigen::Matrix3d by_arm = -turn.matrix(axis.n), by_end = -turn.by_axis(axis.n, a) * axis.derivative;
    Row row = Row::Zero(3, 3 * places);
    row.middleCols<3>(3 * t_a) = by_arm;
    row.middleCols<3>(3 * e_a) = by_end;
    row.middleCols<3>(3 * s_a) = -by_arm - by_end;
    return row;
  }

  /// Adds the second derivative of - r . turn(n) a for constant r, n a function of e, with respect to the points.
  static void add_axis_curvature(const Turn& turn, const Axis& axis, const Eigen::Vector3d& a, const Eigen::Vector3d& r,
                                 Matrix& H) {
    const Eigen::Vector3d& n = axis.n;
    const Eigen::Matrix3d& N = axis.derivative;
    const Eigen::Vector3d by_n = turn.by_axis(n, a).transpose() * r;
    const Eigen::Matrix3d by_n_n = turn.axial * (a * r.transpose() + r * a.transpose());
    const Eigen::Matrix3d by_n_a =
        -turn.across * cross_matrix(r) + turn.axial * (n.dot(r) * Eigen::Matrix3d::Identity() + r * n.transpose());
    // d2(w . n)/de2 = -(N w n^T + n w^T N + (n . w) N)/|e|.
    const Eigen::Vector3d Nw = N * by_n;
    const Eigen::Matrix3d ee =
        N * by_n_n * N - (Nw * n.transpose() + n * Nw.transpose() + n.dot(by_n) * N) / axis.length;
    const Eigen::Matrix3d ea = N * by_n_a;
    const auto block = [&](int p, int q) { return H.block<3, 3>(3 * p, 3 * q); };
    block(e_a, e_a) -= ee;
    block(e_a, t_a) -= ea;
    block(t_a, e_a) -= ea.transpose();
    block(e_a, s_a) += ee + ea;
    block(s_a, e_a) += ee + ea.transpose();
    block(t_a, s_a) += ea.transpose();
    block(s_a, t_a) += ea;
    block(s_a, s_a) -= ee + ea + ea.transpose();
  }

  NodeSet on_;
  bool has_motor_point_ = false;
  Eigen::MatrixXd to_nodes_;  ///< (unknowns of the nodes x 3 places): weight of a node in a point
  Places rest_ = Places::Zero();
};

class JointTerm final : public Term {
 public:
  JointTerm(const Mesh& mesh, const Joint& joint)
      : springs_(mesh, joint), angle_(joint.angle), pin_(joint.pin_stiffness), motor_(joint.motor_stiffness) {}

  Cliques cliques() const override { return springs_.on().cliques(); }

  void assemble(const Point& at, Assembly& out) const override {
    const Places v = springs_.displacements(at.u);
    out.add_energy(at.p[pin_] * springs_.pin_energy(v));
    Vector g = at.p[pin_] * springs_.pin_gradient(v);
    Matrix H;
    if (out.wants_hessian()) H = at.p[pin_] * Springs::pin_hessian();
    if (angle_ >= 0) {
      const double k = at.p[motor_];
      const Springs::Motor motor = springs_.motor(v, at.p[angle_]);
      out.add_energy(0.5 * k * motor.r.squaredNorm());
      g += k * (motor.by_points.transpose() * motor.r);
      if (out.wants_hessian()) {
        H += k * (motor.by_points.transpose() * motor.by_points);
        if (out.curvature == Curvature::exact) H += k * motor.curvature;
      }
    }
    if (out.gradient != nullptr) springs_.scatter(g, *out.gradient);
    if (out.wants_hessian()) springs_.on().add_hessian(springs_.on_nodes(H), out);
  }

  bool depends_on(int index) const override {
    return index >= 0 && (index == pin_ || (angle_ >= 0 && (index == angle_ || index == motor_)));
  }

  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override {
    if (!depends_on(index)) return;
    const Places v = springs_.displacements(at.u);
    Vector g = Vector::Zero(3 * places);
    if (index == pin_) g += springs_.pin_gradient(v);
    if (angle_ >= 0) {
      const Springs::Motor motor = springs_.motor(v, at.p[angle_]);
      if (index == motor_) g += motor.by_points.transpose() * motor.r;
      if (index == angle_)
        g += at.p[motor_] * (motor.by_points.transpose() * motor.by_angle + motor.mixed.transpose() * motor.r);
    }
    springs_.scatter(g, out);
  }

 private:
  Springs springs_;
  int angle_, pin_, motor_;
};

class GapChannel final : public Channel {
 public:
  GapChannel(const Mesh& mesh, const Joint& joint) : springs_(mesh, joint) {}
  double value(const Point& at) const override {
    return std::sqrt(2 * springs_.pin_energy(springs_.displacements(at.u)));
  }
  Eigen::VectorXd gradient(const Point& at) const override {
    const double gap = value(at);
    return springs_.spread(springs_.pin_gradient(springs_.displacements(at.u)) / (gap > 0 ? gap : 1), at);
  }

 private:
  Springs springs_;
};

class AngleChannel final : public Channel {
 public:
  AngleChannel(const Mesh& mesh, const Joint& joint) : springs_(mesh, joint), angle_(joint.angle) {
    if (!springs_.has_motor_point())
      throw InputError(
          fmt::format("joint '{}' has no motor point, so its angle is not defined; give it one", joint.name));
  }

  double value(const Point& at) const override {
    const Arms arms = arms_at(at.u);
    const double turned = std::atan2(arms.sine(), arms.cosine());
    if (angle_ < 0) return turned;
    const double commanded = at.p[angle_];
    return commanded + std::remainder(turned - commanded, 2 * std::numbers::pi);
  }

  Eigen::VectorXd gradient(const Point& at) const override {
    const Arms m = arms_at(at.u);
    const double S = m.sine(), C = m.cosine(), square = S * S + C * C;
    const Eigen::Vector3d &a = m.a, &b = m.b, &n = m.axis.n;
    const auto combine = [&](const Eigen::Vector3d& of_sine, const Eigen::Vector3d& of_cosine) -> Eigen::Vector3d {
      return (C * of_sine - S * of_cosine) / square;
    };
    const Eigen::Vector3d by_a = combine(b.cross(n), b - n.dot(b) * n), by_b = combine(n.cross(a), a - n.dot(a) * n);
    const Eigen::Vector3d by_e = m.axis.derivative * combine(a.cross(b), -n.dot(b) * a - n.dot(a) * b);
    Places g = Places::Zero();
    g.col(t_a) = by_a;
    g.col(t_b) = by_b;
    g.col(e_a) = by_e;
    g.col(s_a) = -by_a - by_e;
    g.col(s_b) = -by_b;
    return springs_.spread(g.reshaped(), at);
  }

 private:
  struct Arms {
    Eigen::Vector3d a, b;
    Springs::Axis axis;
    double sine() const { return axis.n.dot(a.cross(b)); }
    double cosine() const { return a.dot(b) - axis.n.dot(a) * axis.n.dot(b); }
  };
  Arms arms_at(const Eigen::VectorXd& u) const {
    const Places x = springs_.positions(springs_.displacements(u));
    return {x.col(t_a) - x.col(s_a), x.col(t_b) - x.col(s_b), springs_.axis(x)};
  }

  Springs springs_;
  int angle_;
};

class TorqueChannel final : public Channel {
 public:
  TorqueChannel(const Mesh& mesh, const Joint& joint)
      : springs_(mesh, joint), angle_(joint.angle), stiffness_(joint.motor_stiffness) {
    if (angle_ < 0)
      throw InputError(fmt::format("joint '{}' is a free pin, so it has no torque; give it a motor point", joint.name));
  }

  double value(const Point& at) const override {
    const Springs::Motor motor = motor_at(at);
    return at.p[stiffness_] * motor.r.dot(motor.by_angle);
  }
  Eigen::VectorXd gradient(const Point& at) const override {
    const Springs::Motor motor = motor_at(at);
    return springs_.spread(
        at.p[stiffness_] * (motor.by_points.transpose() * motor.by_angle + motor.mixed.transpose() * motor.r), at);
  }
  double parameter_derivative(const Point& at, int index) const override {
    if (index < 0 || (index != angle_ && index != stiffness_)) return 0;
    const Springs::Motor motor = motor_at(at);
    if (index == stiffness_) return motor.r.dot(motor.by_angle);
    return at.p[stiffness_] * (motor.by_angle.squaredNorm() + motor.r.dot(motor.by_angle_twice));
  }

 private:
  Springs::Motor motor_at(const Point& at) const { return springs_.motor(springs_.displacements(at.u), at.p[angle_]); }

  Springs springs_;
  int angle_, stiffness_;
};

}  // namespace

Attachment make_attachment(const Mesh& mesh, const Part& part, const Eigen::VectorXd& point, double radius) {
  if (!(radius >= 0))
    throw InputError(
        fmt::format("a radius of attachment is {:.4g} mm; it must be 0 (one point) or positive", radius * 1e3));
  const MaterialPoint centre = locate(mesh, point, part);
  if (radius == 0) return {point, centre.nodes, centre.weights};
  const int d = mesh.dimension(), per_element = mesh.nodes_per_element();
  std::map<int, double> share;
  for (int e = part.first_element; e < part.first_element + part.element_count; ++e) {
    const int* nodes = mesh.element(e);
    const bool contains = std::all_of(centre.nodes.begin(), centre.nodes.end(), [&](int node) {
      return std::find(nodes, nodes + per_element, node) != nodes + per_element;
    });
    if (!contains && (mesh.centroid(e) - point).norm() > radius) continue;
    const double measure = std::abs(vertex_determinant(mesh, e)) / (d == 2 ? 2 : 6);
    for (int a = 0; a < per_element; ++a) share[nodes[a]] += measure / per_element;
  }
  // min sum w^2/m with M w = (1, 0), M the affine functions about the point: least squares of minimum norm in
  // w/sqrt(m).
  Attachment result{point, {}, {}};
  Eigen::MatrixXd M(d + 1, share.size());
  Eigen::VectorXd m(M.cols());
  for (const auto& [node, measure] : share) {
    const Eigen::Index k = static_cast<Eigen::Index>(result.nodes.size());
    M(0, k) = 1;
    M.col(k).tail(d) = (mesh.node(node) - point) / radius;
    m[k] = measure;
    result.nodes.push_back(node);
  }
  const Eigen::VectorXd root = m.cwiseSqrt();
  const Eigen::VectorXd w =
      root.cwiseProduct(minimum_norm_solution(M * root.asDiagonal(), Eigen::VectorXd::Unit(d + 1, 0)));
  result.weights.assign(w.begin(), w.end());
  return result;
}

Attachment world_attachment(const Eigen::VectorXd& point) {
  return {point, {}, {}};
}

std::unique_ptr<Term> make_joint(const Mesh& mesh, const Joint& joint) {
  return std::make_unique<JointTerm>(mesh, joint);
}

std::unique_ptr<Channel> make_joint_gap(const Mesh& mesh, const Joint& joint) {
  return std::make_unique<GapChannel>(mesh, joint);
}

std::unique_ptr<Channel> make_joint_angle(const Mesh& mesh, const Joint& joint) {
  return std::make_unique<AngleChannel>(mesh, joint);
}

std::unique_ptr<Channel> make_joint_torque(const Mesh& mesh, const Joint& joint) {
  return std::make_unique<TorqueChannel>(mesh, joint);
}

}  // namespace taut
