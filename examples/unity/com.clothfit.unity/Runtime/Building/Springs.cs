using System;
using System.Collections.Generic;
using UnityEngine;

namespace Clothfit
{
    /// <summary>
    /// Springs, stiffnesses and masses of a mesh of triangles (a, b, c). Their sides ab, ac, bc are met in turn: the
    /// first at an edge gives a spring along it (traction), the second one between the two corners opposite it
    /// (bending). With A the area of a triangle, L the length of the spring, E the stiffness and ρ the density:
    /// traction E ΣA / L² over the triangles at the edge; bending (E/4) 2 A / L² of the second triangle; mass ρ ΣA / 3.
    /// </summary>
    public sealed class Springs
    {
        const double BendingShare = 0.25;

        public readonly List<int> Ends = new List<int>(); // 2 S, the smaller number of a pair first
        public readonly List<float> Stiffness = new List<float>(); // S, N/m
        public readonly List<float> Mass = new List<float>(); // n, kg

        readonly Vector3[] places;

        /// <summary>Throws ArgumentException where more than two triangles share an edge.</summary>
        public Springs(Vector3[] places, int[] triangles, float density, float stiffness, bool bending)
        {
            this.places = places;
            double[] areas = Areas(triangles), mass = new double[places.Length];
            for (int k = 0; k < triangles.Length; k++) mass[triangles[k]] += density * areas[k / 3] / 3;
            foreach (double each in mass) Mass.Add((float)each);
            var sides = new Dictionary<long, Side>();
            for (int t = 0; t < areas.Length; t++) Meet(sides, triangles, t, areas[t], stiffness, bending);
            foreach (Side side in sides.Values) Stiffness[side.Spring] = Traction(stiffness, side);
        }

        /// <summary>An edge, with what has been met of it.</summary>
        sealed class Side
        {
            public int Spring, Opposite, Count;
            public double Area;
        }

        void Meet(Dictionary<long, Side> sides, int[] triangles, int t, double area, float stiffness, bool bending)
        {
            int a = triangles[3 * t], b = triangles[3 * t + 1], c = triangles[3 * t + 2];
            foreach (int[] side in new[] { new[] { a, b, c }, new[] { a, c, b }, new[] { b, c, a } })
            {
                int low = Math.Min(side[0], side[1]), high = Math.Max(side[0], side[1]);
                Side met;
                if (!sides.TryGetValue(((long)low << 32) + high, out met))
                {
                    met = sides[((long)low << 32) + high] = new Side { Spring = Stiffness.Count, Opposite = side[2] };
                    Add(low, high, 0f);
                }
                else if (bending && met.Count == 1)
                {
                    double rest = Length(met.Opposite, side[2]);
                    if (rest == 0) throw new ArgumentException("two triangles lie upon each other at the edge " + low + ", " + high);
                    Add(Math.Min(met.Opposite, side[2]), Math.Max(met.Opposite, side[2]),
                        (float)(BendingShare * stiffness * 2 * area / (rest * rest)));
                }
                met.Area += area;
                if (++met.Count > 2) throw new ArgumentException("more than two triangles share the edge " + low + ", " + high);
            }
        }

        void Add(int a, int b, float stiffness)
        {
            Ends.Add(a);
            Ends.Add(b);
            Stiffness.Add(stiffness);
        }

        float Traction(float stiffness, Side side)
        {
            double length = Length(Ends[2 * side.Spring], Ends[2 * side.Spring + 1]);
            return (float)(stiffness * side.Area / (length * length));
        }

        double Length(int a, int b)
        {
            double x = (double)places[a].x - places[b].x, y = (double)places[a].y - places[b].y;
            double z = (double)places[a].z - places[b].z;
            return Math.Sqrt(x * x + y * y + z * z);
        }

        double[] Areas(int[] triangles)
        {
            var areas = new double[triangles.Length / 3];
            for (int t = 0; t < areas.Length; t++)
            {
                Vector3 a = places[triangles[3 * t]], b = places[triangles[3 * t + 1]], c = places[triangles[3 * t + 2]];
                double px = (double)b.x - a.x, py = (double)b.y - a.y, pz = (double)b.z - a.z;
                double qx = (double)c.x - a.x, qy = (double)c.y - a.y, qz = (double)c.z - a.z;
                double x = py * qz - pz * qy, y = pz * qx - px * qz, z = px * qy - py * qx;
                areas[t] = Math.Sqrt(x * x + y * y + z * z) / 2;
            }
            return areas;
        }
    }
}
