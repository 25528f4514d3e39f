using UnityEngine;

namespace Clothfit
{
    /// <summary>A rectangle of vertices in the plane of x and z, about the origin, as a cloth is made of.</summary>
    public static class PlaneMesh
    {
        /// <summary>
        /// A mesh of divisions + 2 vertices along the longer side, and as many along the other as keep cells nearest to
        /// squares. Vertex i along x and j along z has the number j · columns + i.
        /// </summary>
        public static Mesh Make(int divisions, float width, float length)
        {
            float longer = Mathf.Max(width, length);
            int across = Cells(divisions, width, longer), along = Cells(divisions, length, longer);
            var mesh = new Mesh { name = "Clothfit plane" };
            if ((across + 1) * (along + 1) > 65535) mesh.indexFormat = UnityEngine.Rendering.IndexFormat.UInt32;
            mesh.vertices = Vertices(across, along, width, length);
            mesh.uv = Texture(across, along);
            mesh.triangles = Triangles(across, along);
            mesh.RecalculateNormals();
            mesh.RecalculateBounds();
            return mesh;
        }

        static int Cells(int divisions, float side, float longer)
        {
            return Mathf.Max(1, Mathf.RoundToInt((divisions + 1) * side / longer));
        }

        static Vector3[] Vertices(int across, int along, float width, float length)
        {
            var places = new Vector3[(across + 1) * (along + 1)];
            for (int j = 0; j <= along; j++)
                for (int i = 0; i <= across; i++)
                    places[j * (across + 1) + i] = new Vector3(Place(i, across, width), 0f, Place(j, along, length));
            return places;
        }

        static float Place(int i, int cells, float side)
        {
            return (float)(((double)i / cells - 0.5) * side);
        }

        static Vector2[] Texture(int across, int along)
        {
            var places = new Vector2[(across + 1) * (along + 1)];
            for (int j = 0; j <= along; j++)
                for (int i = 0; i <= across; i++)
                    places[j * (across + 1) + i] = new Vector2((float)i / across, (float)j / along);
            return places;
        }

        /// <summary>Two triangles for each cell, column by column: clockwise from above, Unity's front.</summary>
        static int[] Triangles(int across, int along)
        {
            var corners = new int[6 * across * along];
            int k = 0;
            for (int i = 0; i < across; i++)
                for (int j = 0; j < along; j++)
                {
                    int a = j * (across + 1) + i, b = a + across + 1, c = b + 1, d = a + 1;
                    foreach (int corner in new[] { a, b, c, a, c, d }) corners[k++] = corner;
                }
            return corners;
        }
    }
}
