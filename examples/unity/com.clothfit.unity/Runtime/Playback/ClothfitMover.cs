using System.Collections.Generic;
using UnityEngine;

namespace Clothfit
{
    /// <summary>Moves a copy of the mesh beside it, and gives the mesh back as it was when it is switched off.</summary>
    [RequireComponent(typeof(MeshFilter))]
    [DisallowMultipleComponent]
    public abstract class ClothfitMover : MonoBehaviour
    {
        Mesh copy;
        Vector3[] vertices, normals;

        /// <summary>The mesh before it was moved; null while none is.</summary>
        public Mesh Original { get; private set; }

        /// <summary>Why nothing is played, or null.</summary>
        public string Error { get; protected set; }

        /// <summary>The cloth's vertices among those of the mesh. Throws FormatException where there is no mesh.</summary>
        protected Weld Welded()
        {
            Mesh mesh = Original != null ? Original : GetComponent<MeshFilter>().sharedMesh;
            if (mesh == null) throw new System.FormatException(name + ": there is no mesh to move");
            return new Weld(mesh);
        }

        /// <summary>Puts the vertices of the mesh at places in the world, m; with normals where they are known.</summary>
        protected void Move(Weld weld, IList<Vector3> places, IList<Vector3> directions = null)
        {
            if (copy == null) Begin();
            for (int i = 0; i < vertices.Length; i++)
            {
                int own = weld.OfMesh[i];
                if (own < 0) continue;
                vertices[i] = transform.InverseTransformPoint(places[own]);
                if (directions != null) normals[i] = transform.InverseTransformDirection(directions[own]);
            }
            copy.vertices = vertices;
            if (directions == null) copy.RecalculateNormals();
            else copy.normals = normals;
            copy.RecalculateBounds();
        }

        /// <summary>Gives the mesh back as it was.</summary>
        public virtual void Close()
        {
            if (copy == null) return;
            GetComponent<MeshFilter>().sharedMesh = Original;
            if (Application.isPlaying) Destroy(copy);
            else DestroyImmediate(copy);
            copy = Original = null;
        }

        protected void Fail(string message)
        {
            Close();
            Error = message;
            Debug.LogError("Clothfit: " + message, this);
        }

        void Begin()
        {
            var filter = GetComponent<MeshFilter>();
            Original = filter.sharedMesh;
            copy = Instantiate(Original);
            copy.name = Original.name + " (motion)";
            copy.hideFlags = HideFlags.DontSave;
            vertices = Original.vertices;
            normals = new Vector3[vertices.Length];
            filter.sharedMesh = copy;
        }

        protected virtual void OnDisable()
        {
            Close();
        }
    }
}
