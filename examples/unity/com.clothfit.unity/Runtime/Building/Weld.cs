using System.Collections.Generic;
using UnityEngine;

namespace Clothfit
{
    /// <summary>
    /// The vertices of a cloth among those of a mesh. A mesh has several vertices in one place where its texture or its
    /// normals have a seam; they are one vertex of the cloth, at the first of them.
    /// </summary>
    public sealed class Weld
    {
        public readonly Vector3[] Places; // n, m, in the mesh's axes
        public readonly int[] Triangles; // 3 T, vertices of the cloth
        public readonly int[] OfMesh; // for each vertex of the mesh its vertex of the cloth, or -1 where no triangle has it

        public Weld(Mesh mesh) : this(mesh.vertices, mesh.triangles)
        {
        }

        public Weld(Vector3[] vertices, int[] triangles)
        {
            var used = new bool[vertices.Length];
            foreach (int corner in triangles) used[corner] = true;
            var places = new List<Vector3>();
            var found = new Dictionary<Vector3, int>();
            OfMesh = new int[vertices.Length];
            for (int i = 0; i < vertices.Length; i++)
            {
                OfMesh[i] = -1;
                if (!used[i]) continue;
                int at;
                Vector3 place = vertices[i] + Vector3.zero; // 0 for -0, which has another hash
                if (!found.TryGetValue(place, out at))
                {
                    found[place] = at = places.Count;
                    places.Add(vertices[i]);
                }
                OfMesh[i] = at;
            }
            Places = places.ToArray();
            Triangles = Sound(triangles);
        }

        /// <summary>The triangles with three different corners.</summary>
        int[] Sound(int[] triangles)
        {
            var kept = new List<int>(triangles.Length);
            for (int k = 0; k + 2 < triangles.Length; k += 3)
            {
                int a = OfMesh[triangles[k]], b = OfMesh[triangles[k + 1]], c = OfMesh[triangles[k + 2]];
                if (a != b && b != c && c != a) kept.AddRange(new[] { a, b, c });
            }
            return kept.ToArray();
        }
    }
}
